"""The peers: which script runs each, with what options, and where it has a place."""

from __future__ import annotations

from dataclasses import dataclass

PACKAGES = ("tesseract-robotics-nanobind", "roboplan", "pin-pink")


@dataclass(frozen=True)
class Peer:
    """One way of planning with a package.

    script beside this module; options of it, others where the part stands on a table; table_only: only there
    """

    package: str
    script: str
    words: str
    options: tuple[str, ...] = ()
    with_table: tuple[str, ...] = ()
    table_only: bool = False

    def options_for(self, table: bool) -> tuple[str, ...]:
        """The script's options for a case."""
        return self.with_table if table and self.with_table else self.options


PEERS = {
    "descartes_10": Peer(PACKAGES[0], "run_tesseract.py", "Descartes 10°", ("10", "30")),
    "descartes_5": Peer(PACKAGES[0], "run_tesseract.py", "Descartes 5°", ("5", "30")),
    "descartes_30": Peer(PACKAGES[0], "run_tesseract.py", "Descartes 30°", ("30", "60"), table_only=True),
    "trajopt": Peer(
        PACKAGES[0],
        "run_tesseract.py",
        "TrajOpt from Descartes",
        ("10", "30", "trajopt"),
        ("30", "60", "trajopt"),
    ),
    "roboplan": Peer(PACKAGES[1], "run_roboplan.py", "OInK"),
    "pink": Peer(PACKAGES[2], "run_pink.py", "with ManipulabilityTask"),
}
