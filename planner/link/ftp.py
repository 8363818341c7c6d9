"""Uploads files to the controller over FTP, an option of IRC5, in place of its web services."""

from __future__ import annotations

import ftplib
import re
import socket
from collections.abc import Callable
from functools import partial

from planner.base.errors import InputError
from planner.link.connections import CONNECT_TIME, Address, Cutter, LinkError, Secret

PORT = 21
HOME = "HOME"  # relative to the login's directory
QUICK = 10.0  # s for a login or a query
SLOWEST_LINE = 50e3  # bytes/s
_FOLDER = re.compile(r"[A-Za-z0-9_.:/$-]{1,200}")


class Ftp:
    """A session with a controller's FTP server; passwords cross the network unencrypted."""

    def __init__(self, address: Address, user: str, secret: Secret, folder: str = HOME) -> None:
        """folder: the controller's HOME in FTP. Raises InputError for a wrong host, user or folder, else LinkError."""
        if _FOLDER.fullmatch(folder) is None:
            raise InputError(f"{folder!r} is no folder", field="--ftp-folder")
        self._address, self._cutter = address, Cutter()
        self._ftp = _WatchedFtp(self._cutter)
        self._do(partial(self._log_in, user, secret, folder), QUICK)

    def upload(self, name: str, data: bytes) -> None:
        """Put a file into the folder, and check that it has arrived whole."""
        self._do(partial(self._store, name, data), QUICK + len(data) / SLOWEST_LINE)

    def close(self) -> None:
        """End the session."""
        if self._ftp.sock is None:
            return
        try:
            with self._cutter.within(QUICK):
                self._ftp.quit()
        except (ftplib.Error, OSError, EOFError):
            self._ftp.close()

    def _do(self, deed: Callable[[], None], seconds: float) -> None:
        try:
            with self._cutter.within(seconds):
                deed()
        except TimeoutError:
            self._ftp.close()
            raise LinkError(f"the controller's FTP server at {self._address} does not answer in time") from None
        except (ftplib.Error, OSError, EOFError, ValueError) as error:  # ValueError: the answer is no text
            self._ftp.close()
            raise LinkError(f"the controller's FTP server at {self._address}: {_words(error)}") from None
        except (InputError, LinkError):
            self._ftp.close()
            raise

    def _log_in(self, user: str, secret: Secret, folder: str) -> None:
        try:
            self._ftp.connect(self._address.host, self._address.port, timeout=CONNECT_TIME)
        except socket.gaierror as error:
            raise InputError(f"FTP: there is no host {self._address.host}", hint=error.strerror) from None
        try:
            self._ftp.login(user, secret.reveal())
        except ftplib.error_perm:
            where = f"the controller's FTP server at {self._address}"
            raise InputError(f"{where} does not take user and password", hint="see --user") from None
        try:
            self._ftp.cwd(folder)
        except ftplib.error_perm:
            raise InputError(f"the controller's FTP server has no folder {folder}", field="--ftp-folder") from None
        self._ftp.voidcmd("TYPE I")

    def _store(self, name: str, data: bytes) -> None:
        with self._ftp.transfercmd(f"STOR {name}") as made:
            made.sendall(data)
            made.shutdown(socket.SHUT_WR)  # closing alone would not end it, as the cutter holds a duplicate
        self._cutter.forget("data")
        self._ftp.voidresp()
        size = self._ftp.size(name)
        if size != len(data):
            raise LinkError(f"{name} arrived with {size} of {len(data)} bytes")


class _WatchedFtp(ftplib.FTP):
    """FTP whose command and data connections are cut at a deadline."""

    def __init__(self, cutter: Cutter) -> None:
        self._cutter = cutter
        super().__init__()

    def connect(self, host: str = "", port: int = 0, timeout: float = -999, source_address=None) -> str:  # type: ignore[no-untyped-def, override]
        """Connect; the deadline applies from before the greeting."""
        self.host, self.port, self.timeout = host, port, timeout
        self.sock = socket.create_connection((host, port), timeout)
        self._cutter.watch("commands", self.sock)
        self.af = self.sock.family
        self.file = self.sock.makefile("r", encoding=self.encoding)
        self.welcome = self.getresp()
        return self.welcome

    def ntransfercmd(self, cmd: str, rest: int | str | None = None) -> tuple[socket.socket, int | None]:
        """A data connection, subject to the deadline."""
        made, size = super().ntransfercmd(cmd, rest)
        self._cutter.watch("data", made)
        return made, size

    def close(self) -> None:
        """Close both connections, and stop watching them."""
        super().close()
        for name in ("commands", "data"):
            self._cutter.forget(name)


def _words(error: Exception) -> str:
    text = str(error) or type(error).__name__
    return "".join(c if c.isprintable() else " " for c in text[:200])
