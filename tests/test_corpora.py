"""Published collections, a sample of each: printed or refused with the reason. Skipped where they cannot be had."""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import tarfile
import zipfile
from pathlib import Path

import pytest

from benchmarks import corpus_archives
from benchmarks.corpora import CRASHED, MADE, REFUSED, build_toolpath, kind_of, main, report, run, sampled
from benchmarks.corpus_archives import ARCHIVES, NoArchive
from planner.problem import find_problem

SAMPLES = {"aerofoils": 20, "logos": 40}
SEED = 20
LEAST_MADE = {"aerofoils": 0.95, "logos": 0.9}  # of a sample; of all, see README


@pytest.mark.slow
@pytest.mark.parametrize("corpus", sorted(ARCHIVES))
def test_a_sample_is_printed_or_refused(corpus: str) -> None:
    try:
        files = ARCHIVES[corpus].files()
    except NoArchive as reason:
        pytest.skip(str(reason))
    outcomes = [run(corpus, frozenset(), case) for case in sampled(files, SAMPLES[corpus], SEED).items()]
    assert not [outcome for outcome in outcomes if outcome.verdict == CRASHED]
    assert sum(outcome.verdict == MADE for outcome in outcomes) >= LEAST_MADE[corpus] * len(outcomes)


SECTION = (find_problem("naca0015_wing").parent / "naca0015_arigela.dat").read_text("utf-8")
DRAWING = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 9 9"><path d="M1 1h7v7h-7z"/></svg>'


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize(
    ("corpus", "name", "content", "verdict", "detail"),
    [
        ("aerofoils", "a.dat", SECTION, MADE, ""),
        ("aerofoils", "a.dat", SECTION + "1.0 0.0.9", REFUSED, "'0.0.9' is not a number (line "),
        ("logos", "a.svg", DRAWING, MADE, ""),
        ("logos", "a.svg", DRAWING.replace("h7", "x7"), REFUSED, "path data is wrong"),
    ],
)
def test_what_becomes_of_a_file(corpus: str, name: str, content: str, verdict: str, detail: str) -> None:
    outcome = run(corpus, frozenset(), (name, content.encode()))
    assert (outcome.name, outcome.verdict) == (name, verdict)
    assert detail in outcome.detail


@pytest.mark.parametrize(("corpus", "builder"), [("aerofoils", SECTION), ("logos", DRAWING)])
def test_crashes_and_wrong_toolpaths_are_told(corpus: str, builder: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def wrong(problem: object) -> object:
        toolpath = build_toolpath(problem)  # type: ignore[arg-type]
        beads = tuple(
            dataclasses.replace(
                bead, points=bead.points + [0.0, 0.0, 0.01] if corpus == "aerofoils" else 1.01 * bead.points
            )
            for bead in toolpath.beads
        )
        return dataclasses.replace(toolpath, beads=beads)

    def crash(problem: object) -> object:
        raise ZeroDivisionError

    name = "a.dat" if corpus == "aerofoils" else "a.svg"
    for broken, told in ((wrong, "Nonsense"), (crash, "ZeroDivisionError")):
        monkeypatch.setattr("benchmarks.corpora.build_toolpath", broken)
        outcome = run(corpus, frozenset(), (name, builder.encode()))
        assert outcome.verdict == CRASHED and told in outcome.detail
    assert "ZeroDivisionError" in str(list(report([outcome], 1.0).columns[2].cells))


def test_reasons_are_counted_without_names_and_numbers() -> None:
    assert kind_of("path 'a b' is only 0.13 mm long") == kind_of("path 'c' is only 1e-05 mm long")
    assert kind_of("ag24.dat has no length") == kind_of("e540.dat has no length")


def test_archives_are_checked_and_unpacked_in_memory(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wheel, tar = tmp_path / "a.whl", tmp_path / "a.tgz"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("../../outside/a.dat", "A\n")
        archive.writestr("b.py", "B\n")
    icons = {"height": 20, "icons": {"one": {"body": "<path/>", "width": 30, "left": -1}}}
    with tarfile.open(tar, "w:gz") as packed:
        content = json.dumps(icons).encode()
        member = tarfile.TarInfo("package/icons.json")
        member.size = len(content)
        packed.addfile(member, io.BytesIO(content))
    assert main(["aerofoils", "--archive", str(wheel)]) == 2
    assert "is not aerosandbox" in capsys.readouterr().err
    digests = {path: "sha256:" + hashlib.sha256(path.read_bytes()).hexdigest() for path in (wheel, tar)}
    aerofoils = dataclasses.replace(ARCHIVES["aerofoils"], digest=digests[wheel])
    assert aerofoils.files(wheel) == {"a.dat": b"A\n"}
    logos = dataclasses.replace(ARCHIVES["logos"], digest=digests[tar])
    (drawing,) = logos.files(tar).values()
    assert b'width="30" height="20" viewBox="-1 0 30 20"><path/></svg>' in drawing
    assert sorted(tmp_path.iterdir()) == [tar, wheel]


def test_where_nothing_can_be_fetched_the_reason_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(corpus_archives, "CACHE", tmp_path / "cache")
    monkeypatch.setattr(corpus_archives.shutil, "which", lambda _: None)
    monkeypatch.delenv("npm_config_registry", raising=False)
    assert main(["logos"]) == 2
    assert "--archive FILE" in capsys.readouterr().err
    assert main(["logos", "--archive", str(tmp_path / "none.tgz")]) == 2
    assert "cannot read" in capsys.readouterr().err
    assert list((tmp_path / "cache").iterdir()) == []
