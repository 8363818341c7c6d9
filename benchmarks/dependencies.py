"""What is installed for which purpose: lock files, a page of every package's licence, and known advisories.

python -m benchmarks.dependencies locks       (make requirements)
python -m benchmarks.dependencies licences    (make licences)
python -m benchmarks.dependencies advisories  (make advisories)
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution, distributions
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from planner.base.command_line import exit_code
from planner.base.errors import InputError

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "licences.md"
PROJECT = "beadwise"
BUILDER = "hatchling"  # installs the checkout itself, so the lock for running has it
RUNNING, TESTING = "requirements.txt", "requirements-test.txt"
PURPOSES = {
    RUNNING: (
        "To run",
        "`make solve` installs these; `pip install beadwise` the same without hatchling and what it needs.",
    ),
    TESTING: ("Extras, and tests", "`make test` and `make lint` install these besides."),
    "requirements-notebooks.txt": ("Notebooks", "What the extra `notebooks` adds to what runs."),
    "requirements-docs.txt": ("This site", "`make docs`, in an environment of its own."),
    "requirements-peers.txt": ("Other planners", "`make peers`, in an environment of its own."),
    "requirements-third-party.txt": ("Other people's parsers", "`make third-party`, in an environment of its own."),
    "requirements-advisories.txt": ("Advisories", "`make advisories`, in an environment of its own."),
}
# Where a package's metadata name none, or not which: as its licence file or its source says.
STATED = {
    "abb-robot-client": "Apache-2.0",
    "apsw": "Zlib-like",
    "cmeel-qhull": "Qhull",
    "euclid3": "LGPL-2.1-or-later",
    "rapidchecker": "AGPL-3.0",
    "xacro": "BSD-3-Clause",
}
# Libraries inside of wheels whose licence is another, and copyleft: as licence files of the wheel or of the library say.
WITHIN = {
    "cadquery-ocp-novtk": "Open CASCADE (LGPL-2.1 with exception), FreeImage (GPL-2.0, GPL-3.0 or FIPL), LibRaw (LGPL-2.1 or CDDL-1.0)",
    "casadi": "MUMPS (CeCILL-C), Ipopt, Bonmin, Cbc, Clp (EPL), qpOASES (LGPL-2.1), alpaqa, SLEQP (LGPL-3.0)",
    "lxml": "iconv (LGPL-2.1)",
    "numpy": "libgfortran (GPL-3.0 with GCC exception), libquadmath (LGPL-2.1)",
    "scipy": "libgfortran (GPL-3.0 with GCC exception), libquadmath (LGPL-2.1)",
    "shapely": "GEOS (LGPL-2.1)",
}
ADVISORIES = """\
## Known advisories

    make advisories

asks the Python package index for advisories of what `requirements.txt` and `requirements-test.txt` pin, by pip-audit in an
environment of its own, and lists each version that has one, with the release that mends it. Other locks:
`make advisories LOCKS=requirements-docs.txt`. The command behind it, `python -m benchmarks.dependencies advisories`, ends
with

| | |
|---|---|
| 0 | every version was looked up, and none has a known advisory |
| 2 | wrong input, or pip-audit is not there |
| 3 | some versions have advisories; they are listed |
| 4 | the index was not reached, or has no advisories for some or all of the packages: nothing is known about those |

`make` itself ends with 2 in all cases but the first. Some mirrors of the index serve packages without advisories:
pip-audit then says "No known vulnerabilities found" and ends with 0, which is no answer; the command above says so and
ends with 4.
""".splitlines()
COPYLEFT = ("GPL", "General Public", "MPL", "Mozilla", "EPL", "CeCILL")
NO_NAME = ("", "UNKNOWN", "any-OSI")
LONGEST = 60  # characters: a longer "name" is the licence's text
UNREACHED = 4  # exit code of `advisories` where the index cannot be reached


@dataclass(frozen=True)
class Package:
    """A package as its metadata describe it."""

    name: str
    version: str
    licence: str

    @property
    def key(self) -> str:
        return canonicalize_name(self.name)


# --- locks


def closure(requirements: Sequence[str]) -> frozenset[str]:
    """Normalised names of what is installed for the requirements, with all that these need.

    InputError: a package is not installed.
    """
    found: set[tuple[str, str]] = set()
    left = [Requirement(each) for each in requirements]
    while left:
        requirement = left.pop()
        for extra in sorted(requirement.extras) or [""]:
            if (key := (canonicalize_name(requirement.name), extra)) in found:
                continue
            found.add(key)
            needs = [Requirement(each) for each in _needs(requirement.name, extra)]
            left += [each for each in needs if each.marker is None or each.marker.evaluate({"extra": extra})]
            if extra:
                left.append(Requirement(requirement.name))
    return frozenset(name for name, _ in found if name != PROJECT)


def _needs(name: str, extra: str) -> Sequence[str]:
    """What a package says it needs, the project by its pyproject.toml: what is installed of it may be older."""
    if canonicalize_name(name) != PROJECT:
        return _distribution(name).requires or ()
    stated = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needs: Sequence[str] = stated["optional-dependencies"][extra] if extra else stated["dependencies"]
    return needs


def _distribution(name: str) -> Any:
    try:
        return distribution(name)
    except PackageNotFoundError as error:
        raise InputError(f"{name} is not installed", hint="make .venv/.ready-test") from error


def lock_texts() -> dict[str, str]:
    """Texts of the two lock files of this environment: what runs, and what the extras and tests need besides."""
    running = closure([PROJECT, BUILDER])
    testing = closure([f"{PROJECT}[test]"]) - running
    return {
        RUNNING: _pins(running),
        TESTING: f"-r {RUNNING}\n{_pins(testing)}",
    }


def _pins(names: frozenset[str]) -> str:
    pins = [f"{each.metadata['Name']}=={each.version}" for each in map(_distribution, names)]
    return "".join(f"{pin}\n" for pin in sorted(pins, key=str.lower))


def pinned(lock: str) -> dict[str, tuple[str, str]]:
    """Normalised name → name and version of the packages that a lock file pins itself."""
    lines = (ROOT / lock).read_text(encoding="utf-8").splitlines()
    pairs = [line.split(" ")[0].split("==") for line in lines if "==" in line and not line.startswith("#")]
    return {canonicalize_name(name): (name, version) for name, version in pairs}


# --- licences


def licence_of(name: str, fields: Mapping[str, Any]) -> str:
    """The licence of a package by the fields of its core metadata, as JSON has them."""
    if named := STATED.get(canonicalize_name(name)) or fields.get("license_expression"):
        return str(named)
    lines = str(fields.get("license") or "").strip().splitlines()
    classifiers = [each for each in fields.get("classifier") or () if each.startswith("License :: ")]
    classes = [each.rpartition(" :: ")[2] for each in classifiers if not each.endswith("OSI Approved")]
    if len(lines) == 1 and lines[0] not in NO_NAME and len(lines[0]) <= LONGEST and len(classes) < 2:
        return lines[0]
    return ", ".join(classes) or "not stated"


def packages(lock: str) -> tuple[Package, ...]:
    """The packages that a lock file pins itself, by name; those that are not installed here as the index describes them."""
    pins = pinned(lock)
    known: dict[str, Package] = {}
    for key, (name, version) in pins.items():
        try:
            found = distribution(name)
        except PackageNotFoundError:
            continue
        if found.version == version:
            known[key] = Package(name, version, licence_of(name, found.metadata.json))
    missing = {key: pin for key, pin in pins.items() if key not in known}
    known |= {key: Package(*missing[key], licence_of(key, fields)) for key, fields in _asked(missing, lock)}
    return tuple(known[key] for key in sorted(known))


def _asked(pins: Mapping[str, tuple[str, str]], lock: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Core metadata of packages, from wheels that pip gets or builds and that nobody installs."""
    if not pins:
        return
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--quiet", "--disable-pip-version-check"]
        command += ["--wheel-dir", folder, *map("==".join, pins.values())]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise InputError(f"pip cannot get the packages of {lock}: {done.stderr.strip().splitlines()[-1]}")
        for found in distributions(path=[str(wheel) for wheel in Path(folder).glob("*.whl")]):
            yield canonicalize_name(found.metadata["Name"]), found.metadata.json


def needed_for() -> dict[str, str]:
    """Normalised name → what needs the package, of those in the first two locks: `default`, extras, or `test`."""
    (test,) = (each for each in map(Requirement, _needs(PROJECT, "test")) if each.name == PROJECT)
    purposes = {"default": closure([PROJECT]), "build": closure([BUILDER])}
    purposes |= {extra: closure([f"{PROJECT}[{extra}]"]) for extra in sorted(test.extras)}
    purposes["test"] = closure([f"{PROJECT}[test]"])
    found: dict[str, str] = {}
    for name in purposes["test"] | purposes["build"]:
        named = [purpose for purpose, needed in purposes.items() if name in needed]
        extras_only = [each for each in named if each not in ("default", "build", "test")]
        found[name] = "default" if "default" in named else ", ".join(extras_only) or named[0]
    return found


def section(lock: str, among: Sequence[Package], purposes: Mapping[str, str]) -> list[str]:
    """Lines of the page about one lock file."""
    title, words = PURPOSES[lock]
    told = lock in (RUNNING, TESTING)
    lines = [f"## {title}", "", f"{words} Versions: `{lock}`.", ""]
    lines += [
        "| package | version | licence |" + (" for |" if told else ""),
        "|---|---|---|" + ("---|" if told else ""),
    ]
    for each in among:
        lines.append(
            f"| {each.name} | {each.version} | {each.licence} |" + (f" {purposes[each.key]} |" if told else "")
        )
    return [*lines, ""]


def copyleft(among: Mapping[str, Sequence[Package]]) -> list[str]:
    """Lines of the page about packages that are, or contain, what is under a licence that asks for something in return."""
    lines = ["| package | its licence | within its wheel | installed by |", "|---|---|---|---|"]
    for lock, listed in among.items():
        for each in listed:
            if each.key in WITHIN or any(word in each.licence for word in COPYLEFT):
                lines.append(
                    f"| {each.name} | {each.licence} | {WITHIN.get(each.key, '')} | {PURPOSES[lock][0].lower()} |"
                )
    return lines


def page() -> str:
    """The text of docs/licences.md."""
    listed = {lock: packages(lock) for lock in PURPOSES}
    purposes = needed_for()
    lines = [
        "# Licences",
        "",
        "Beadwise is under BSD-3-Clause ([LICENSE](../LICENSE)). It contains no code of the packages below; pip installs"
        " them. `make licences` writes this page from the metadata that each package publishes.",
        "",
        "## LGPL, GPL and their like",
        "",
        "Whoever passes these on, in an image or a product, owes more than a notice: sources, or a way to exchange the"
        " library, as each licence says. Running them asks for nothing. The AGPL is that of a tool of tests alone.",
        "",
        *copyleft(listed),
        "",
        "Wheels contain compiled libraries, whose licences their metadata seldom name. The third column has those that"
        " licence files in the wheels or of the libraries name as LGPL, GPL, EPL or CeCILL.",
        "",
    ]
    for lock, among in listed.items():
        lines += section(lock, among, purposes)
    lines += [*ADVISORIES]
    return "\n".join(lines).rstrip() + "\n"


# --- advisories


def advisories(locks: Sequence[str], audit: Sequence[str]) -> int:
    """Print the versions in lock files that have known advisories; the exit code: 0 none, 3 some, 4 the index was not
    reached."""
    command = [*audit, "--no-deps", "--disable-pip", "--progress-spinner", "off", "--format", "json"]
    for lock in locks:
        if not (ROOT / lock).is_file():
            raise InputError(f"no lock file {lock}", hint=f"one of: {', '.join(PURPOSES)}")
        command += ["--requirement", str(ROOT / lock)]
    try:
        done = subprocess.run(command, capture_output=True, text=True)
    except OSError as error:
        raise InputError(f"pip-audit does not start: {error}", hint="make advisories") from error
    try:
        answer = json.loads(done.stdout)["dependencies"]
    except (ValueError, KeyError):
        last = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
        print(f"advisories are not known: the index was not reached, or did not answer. pip-audit says: {last}")
        return UNREACHED
    found = [each for each in answer if each.get("vulns")]
    skipped = [each for each in answer if "skip_reason" in each]
    for each in found:
        for vulnerability in each["vulns"]:
            fixed = ", ".join(vulnerability["fix_versions"]) or "no release"
            names = ", ".join([vulnerability["id"], *vulnerability["aliases"]])
            print(f"{each['name']} {each['version']}: {names}; fixed in {fixed}")
    for each in skipped if len(skipped) < len(answer) else ():
        print(f"{each['name']}: not looked up: {each['skip_reason']}")
    if len(skipped) == len(answer):
        print("advisories are not known: the index has no advisories, or none for these packages")
    print(
        f"{len(answer)} packages of {', '.join(locks)}: {len(found)} with known advisories, {len(skipped)} not looked up"
    )
    return 3 if found else UNREACHED if skipped else 0


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("what", choices=("locks", "licences", "advisories"))
    parser.add_argument("--audit", default="pip-audit", metavar="COMMAND", help="pip-audit, where it is installed")
    parser.add_argument(
        "locks", nargs="*", default=[RUNNING, TESTING], metavar="LOCK", help="of advisories (default: the first two)"
    )
    options = parser.parse_intermixed_args(arguments)
    return exit_code(lambda: _run(options), lambda text: print(text, file=sys.stderr))


def _run(options: argparse.Namespace) -> int:
    if options.what == "advisories":
        return advisories(options.locks, [options.audit])
    texts = {PAGE: page()} if options.what == "licences" else {ROOT / name: text for name, text in lock_texts().items()}
    for path, text in texts.items():
        path.write_text(text, encoding="utf-8")
        print(f"{path.relative_to(ROOT)} written")
    return 0


if __name__ == "__main__":
    sys.exit(main())
