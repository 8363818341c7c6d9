"""Common to the commands: the layout of their help, and the reporting of refusals."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec

from planner.base.errors import PlannerError

P = ParamSpec("P")


def told(main: Callable[P, int]) -> Callable[P, int]:
    """The command, with what it refuses said as an error."""

    @wraps(main)
    def run(*args: P.args, **kwargs: P.kwargs) -> int:
        try:
            return main(*args, **kwargs)
        except PlannerError as error:
            print(f"error: {error}", file=sys.stderr)
            return error.exit_code

    return run


def parser_of(name: str, doc: str | None) -> argparse.ArgumentParser:
    """A parser whose help is the module's docstring as it stands."""
    return argparse.ArgumentParser(
        prog=f"python -m benchmarks.{name}", description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
