"""Options of commands that show a page, and printing its address; without the packages that serve it."""

from __future__ import annotations

import argparse
import threading
import webbrowser


def add_page_options(parser: argparse.ArgumentParser, port: str) -> None:
    """Add the port that a page is served on (`port`: the option's name), and whether a browser is opened for it."""
    parser.add_argument(port, type=port_number, default=0, metavar="N", help="of this computer (default: a free one)")
    parser.add_argument("--no-browser", dest="browser", action="store_false", help="only print the address")


def port_number(text: str) -> int:
    """A port on this computer, 0 for a free one; raises argparse.ArgumentTypeError."""
    if not text.isdecimal() or not 0 <= int(text) <= 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port (1 to 65535; 0 takes a free one)")
    return int(text)


def tell_address(what: str, address: str, once: str | None) -> None:
    """Print a page's address, and open a browser at the one-time address `once`, unless that is None."""
    print(f"{what}: {address}", flush=True)
    if once is not None:  # in a thread: it may take a while
        threading.Thread(target=webbrowser.open, args=(once,), daemon=True).start()
