"""Files that a problem names, spoilt: drawings, meshes, faces, waypoints, G-code, robots; each is read or refused by name.

python -m benchmarks.attack --only files

Inputs are small and made here, or shipped ones drawn for this project. Beads of all layers are laid.
"""

from __future__ import annotations

import io
import random
import re
import shutil
import struct
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.attack.cases import Case, Kind, Outcome
from benchmarks.attack.prints import DRAWING
from benchmarks.attack.problems import read
from planner.base.arrays import Array, Ints
from planner.base.shipped import PROBLEMS, ROBOTS

COUNT = 600
SLOW = 0.5  # times as often as others, of a format that another process reads

# ---- inputs -------------------------------------------------------------------------------------------------------------

ON_PLATE = """\
name: spoilt
cell:
  arm: {arm}
  nozzle: {{tip_mm: [-44.51, 9.9, 113.95], axis: [0, 0, 1], diameter_mm: 0.6}}
  home_deg: [0, 0, 0, 0, 90, 0]
  bed_mm: [560, -93, 290]
{layers}
process:
  speed_mm_s: 40
  travel_speed_mm_s: 200
  bead: {{width_mm: 0.6{height}}}
resolve: {{roll_step_deg: 30, rung_mm: 10}}
strategy: ladder
"""


@dataclass(frozen=True)
class Input:
    """A file, and the problem that names it.

    name, data  of the file that is spoilt
    problem     that reads it
    beside      files that are there as they are
    whole       beads are laid; else it is read alone
    """

    name: str
    data: bytes
    problem: str
    beside: tuple[Path, ...] = ()
    whole: bool = True


def _layers(text: str, height: str = ", height_mm: 0.5", arm: str = "irb140") -> str:
    return ON_PLATE.format(layers=text, height=height, arm=arm)


def _drawing(key: str, name: str) -> str:
    return _layers(
        f"part:\n  plane: {{size_mm: [60, 60]}}\nlayers:\n  source: {{{key}: {name}, width_mm: 30}}\n  project: z\n  count: 1\n  height_mm: 0.5"
    )


def _volume(name: str) -> str:
    return _layers(f"layers:\n  source: {{mesh: {name}}}\n  height_mm: 0.5\n  perimeters: 1", "")


def _substrate(name: str) -> str:
    pattern = "{pattern: honeycomb, cell_mm: 4, size_mm: [10, 10]}"
    return _layers(
        f"part:\n  mesh: {{file: {name}}}\nlayers:\n  source: {pattern}\n  project: z\n  count: 1\n  height_mm: 0.5"
    )


def prism() -> tuple[Array, Ints]:
    """Corners (n, 3) [mm] and triangles (m, 3) of a closed, eight-sided block, 2 mm high."""
    turn = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    ring = np.column_stack([np.cos(turn), np.sin(turn)])
    corners = np.vstack([
        np.column_stack([8.0 * ring, np.zeros(8)]), np.column_stack([8.0 * ring, np.full(8, 2.0)]), [[0, 0, 0], [0, 0, 2]],
    ])  # fmt: skip
    k, n = np.arange(8), (np.arange(8) + 1) % 8
    sides = [np.column_stack([k, n, k + 8]), np.column_stack([n, n + 8, k + 8])]
    ends = [np.column_stack([n, k, np.full(8, 16)]), np.column_stack([k + 8, n + 8, np.full(8, 17)])]
    return corners, np.vstack([*sides, *ends])


def stl_text(corners: Array, triangles: Ints) -> bytes:
    facets = "".join(
        "facet normal 0 0 1\nouter loop\n"
        + "".join("vertex {:.4f} {:.4f} {:.4f}\n".format(*corners[i]) for i in face)
        + "endloop\nendfacet\n"
        for face in triangles
    )
    return f"solid block\n{facets}endsolid block\n".encode()


def stl_binary(corners: Array, triangles: Ints) -> bytes:
    facets = b"".join(struct.pack("<12fH", 0, 0, 1, *corners[face].ravel(), 0) for face in triangles)
    return b"block".ljust(80, b"\0") + struct.pack("<I", len(triangles)) + facets


def ply(corners: Array, triangles: Ints, binary: bool) -> bytes:
    form = "binary_little_endian" if binary else "ascii"
    head = (
        f"ply\nformat {form} 1.0\nelement vertex {len(corners)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode()
    if binary:
        return (
            head
            + b"".join(struct.pack("<3f", *p) for p in corners)
            + b"".join(struct.pack("<B3i", 3, *f) for f in triangles)
        )
    return head + _rows(corners, "") + _rows(triangles, "3 ")


def _rows(values: Array | Ints, before: str, shift: int = 0) -> bytes:
    return "".join(before + " ".join(f"{value + shift:g}" for value in row) + "\n" for row in values.tolist()).encode()


def obj(corners: Array, triangles: Ints) -> bytes:
    return b"o block\n" + _rows(corners, "v ") + _rows(triangles, "f ", 1)


def off(corners: Array, triangles: Ints) -> bytes:
    return f"OFF\n{len(corners)} {len(triangles)} 0\n".encode() + _rows(corners, "") + _rows(triangles, "3 ")


def three_mf(corners: Array, triangles: Ints) -> bytes:
    vertices = "".join('<vertex x="{:g}" y="{:g}" z="{:g}"/>'.format(*p) for p in corners)
    faces = "".join('<triangle v1="{}" v2="{}" v3="{}"/>'.format(*f) for f in triangles)
    model = (
        '<?xml version="1.0" encoding="UTF-8"?><model unit="millimeter" '
        'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources><object id="1" type="model"><mesh>'
        f"<vertices>{vertices}</vertices><triangles>{faces}</triangles></mesh></object></resources>"
        '<build><item objectid="1"/></build></model>'
    )
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:  # stored as it is: what is spoilt is the model as often as the archive
        archive.writestr(zipfile.ZipInfo("3D/3dmodel.model"), model)
        archive.writestr(zipfile.ZipInfo("[Content_Types].xml"), '<?xml version="1.0"?><Types/>')
    return out.getvalue()


def dxf() -> bytes:
    """A drawing of release 12: lines, an arc, a circle, a polyline, a block that is inserted."""

    def entity(kind: str, *pairs: object) -> list[object]:
        return [0, kind, 8, "0", *pairs]

    block = [
        0,
        "BLOCK",
        8,
        "0",
        2,
        "MARK",
        70,
        0,
        10,
        0,
        20,
        0,
        *entity("LINE", 10, 0, 20, 0, 11, 2, 21, 1),
        0,
        "ENDBLK",
        8,
        "0",
    ]
    drawn = [
        *entity("LINE", 10, 1, 20, 1, 11, 12, 21, 9), *entity("LINE", 10, 12, 20, 9, 11, 20, 21, 4),
        *entity("CIRCLE", 10, 7, 20, 16, 40, 5), *entity("ARC", 10, 20, 20, 16, 40, 4, 50, 20, 51, 200),
        *entity("POLYLINE", 66, 1, 70, 1), *entity("VERTEX", 10, 22, 20, 6, 42, 0.5), *entity("VERTEX", 10, 28, 20, 6),
        *entity("VERTEX", 10, 25, 20, 11), 0, "SEQEND", 8, "0", *entity("INSERT", 2, "MARK", 10, 26, 20, 20, 41, 2, 50, 30),
    ]  # fmt: skip
    parts = [
        0, "SECTION", 2, "HEADER", 9, "$ACADVER", 1, "AC1009", 0, "ENDSEC", 0, "SECTION", 2, "BLOCKS", *block, 0, "ENDSEC",
        0, "SECTION", 2, "ENTITIES", *drawn, 0, "ENDSEC", 0, "EOF",
    ]  # fmt: skip
    return "".join(f"{part}\n" for part in parts).encode()


def waypoints(header: str, separator: str) -> bytes:
    """A spiral on a cap, each point with its normal [mm]."""
    turn = np.linspace(0.0, 4.0 * np.pi, 80)
    lean = 0.02 * turn
    normal = np.column_stack([np.sin(lean) * np.cos(turn), np.sin(lean) * np.sin(turn), np.cos(lean)])
    rows = np.column_stack([120.0 * normal, normal])
    return (header + "\n" + "".join(separator.join(f"{x:.5f}" for x in row) + "\n" for row in rows.tolist())).encode()


def gcode() -> bytes:
    """Two layers of a square, as slicers write it."""
    lines = ["; generated by a slicer", "M83", "G90", "G28"]
    for z in (0.3, 0.6):
        lines += [
            f";LAYER_CHANGE\n;Z:{z}\n;HEIGHT:0.3",
            f"G1 Z{z} F600",
            "G1 X100 Y100 F6000",
            ";TYPE:Outer wall\n;WIDTH:0.5",
        ]
        for x, y in ((120, 100), (120, 120), (100, 120), (100, 100)):
            lines.append(f"G1 X{x} Y{y} E1.2500 F1800")
        lines += ["G1 E-0.8 F2100", "G2 X110 Y110 I5 J5 E0.5", "G1 X112 Y112 E0.2"]
    return ("\n".join(lines) + "\n").encode()


def inputs() -> dict[str, Input]:
    """By the name of the format."""
    block = prism()
    arm = (ROBOTS / "irb140.yaml").read_text(encoding="utf-8")
    urdf = (ROBOTS / "irb140.urdf").read_bytes()
    flat = "layers:\n  source: {gcode: box.gcode, origin_mm: [-110, -110, 0]}"
    points = "layers:\n  source: {{waypoints: {}}}"
    faces = "part:\n  step: {file: plate.step}\nlayers:\n  source: {faces: [top], spacing_mm: 60, path: rows}\n  count: 1\n  height_mm: 2"
    wing = "layers:\n  source: {aerofoil: wing.dat, chord_mm: 80, span_mm: 20}\n  height_mm: 0.5"
    drawn = _drawing("svg", "drawing.svg")
    return {
        "SVG": Input("drawing.svg", DRAWING.encode(), drawn),
        "DXF": Input("drawing.dxf", dxf(), _drawing("dxf", "drawing.dxf")),
        "STL": Input("block.stl", stl_text(*block), _volume("block.stl")),
        "binary STL": Input("block.stl", stl_binary(*block), _substrate("block.stl")),
        "PLY": Input("block.ply", ply(*block, binary=False), _substrate("block.ply")),
        "binary PLY": Input("block.ply", ply(*block, binary=True), _volume("block.ply")),
        "OBJ": Input("block.obj", obj(*block), _volume("block.obj")),
        "OFF": Input("block.off", off(*block), _substrate("block.off")),
        "3MF": Input("block.3mf", three_mf(*block), _volume("block.3mf")),
        "STEP": Input("plate.step", (PROBLEMS / "curved_plate.step").read_bytes(), _layers(faces)),
        "waypoints": Input("cap.txt", waypoints("# x y z nx ny nz", " "), _layers(points.format("cap.txt"))),
        "waypoints CSV": Input("cap.csv", waypoints("x,y,z,nx,ny,nz", ","), _layers(points.format("cap.csv"))),
        "G-code": Input("box.gcode", gcode(), _layers(flat, "")),
        "URDF": Input("irb140.urdf", urdf, drawn.replace("arm: irb140", "arm: own.yaml"), (Path("own.yaml"), Path("drawing.svg"))),
        "robot": Input("own.yaml", arm.encode(), drawn.replace("arm: irb140", "arm: own.yaml"), (Path("irb140.urdf"), Path("drawing.svg"))),
        "aerofoil": Input("wing.dat", (PROBLEMS / "naca0015_arigela.dat").read_bytes(), _layers(wing), whole=False),
    }  # fmt: skip


# ---- changes: (bytes, random) → bytes -----------------------------------------------------------------------------------

NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
NUMBERS = (
    b"nan", b"NaN", b"inf", b"-inf", b"1e308", b"-1e308", b"1e39", b"1e-320", b"0", b"-0", b"-1", b"1", b"2147483648", b"4294967295",
    b"-2147483649", b"9" * 400, b"1e9999", b"0x10", b"1,5", b"1.2.3", b"--1", b"+", b"", b"1_0", b"\xd9\xa1", b"1e", b"x",
)  # fmt: skip
WORDS = (
    struct.pack("<f", float("nan")), struct.pack("<f", float("inf")), struct.pack("<f", 3e38), struct.pack("<f", 1e-40),
    b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\0\x80", b"\0\0\0\0", struct.pack("<I", 10**6), struct.pack("<I", 10**9),
)  # fmt: skip


def number(data: bytes, by: random.Random) -> bytes:
    found = by.choice(list(NUMBER.finditer(data)) or [re.match(b"", data)])
    assert found is not None
    return data[: found.start()] + by.choice(NUMBERS) + data[found.end() :]


def count(data: bytes, by: random.Random) -> bytes:
    whole = [match for match in NUMBER.finditer(data) if match[0].isdigit()]
    if not whole:
        return number(data, by)
    found = by.choice(whole)
    value = int(found[0]) if len(found[0]) < 20 else 0
    new = by.choice([value + 1, max(0, value - 1), value * 1000, value + 10**6, -value - 1, 2**31, 2**63])
    return data[: found.start()] + str(new).encode() + data[found.end() :]


def scaled(data: bytes, by: random.Random) -> bytes:
    factor = by.choice([1e-9, 1e-3, 0.1, 10.0, 1e3, 1e6, 1e12, -1.0])
    with_points = re.compile(rb"(?<!\d)-?\d+\.\d+")  # from where digits begin: else many of them take hours
    return with_points.sub(lambda match: f"{float(match[0]) * factor:.6g}".encode(), data)


def truncated(data: bytes, by: random.Random) -> bytes:
    return data[: by.randrange(len(data))]


def flipped(data: bytes, by: random.Random) -> bytes:
    out = bytearray(data)
    for _ in range(by.choice([1, 1, 3, 20, 200])):
        out[by.randrange(len(out))] ^= 1 << by.randrange(8)
    return bytes(out)


def swapped(data: bytes, by: random.Random) -> bytes:
    out = bytearray(data)
    i, k = by.randrange(len(out)), by.randrange(len(out))
    n = by.choice([1, 4, 16, 100])
    out[i : i + n], out[k : k + n] = out[k : k + n], out[i : i + n]
    return bytes(out)


def word(data: bytes, by: random.Random) -> bytes:
    k = by.randrange(max(1, len(data) - 4))
    return data[:k] + by.choice(WORDS) + data[k + 4 :]


def block(data: bytes, by: random.Random) -> bytes:
    i = by.randrange(len(data))
    n = by.choice([1, 10, 100, 1000])
    part = data[i : i + n]
    new = by.choice(
        [b"", part + part, bytes(len(part)), part[::-1], by.randbytes(len(part)), b"\xff" * len(part), part * 300]
    )
    return data[:i] + new + data[i + n :]


def lines(data: bytes, by: random.Random) -> bytes:
    rows = data.split(b"\n")
    i, k = by.randrange(len(rows)), by.randrange(len(rows))
    how = by.randrange(4)
    if how == 0:
        del rows[i]
    elif how == 1:
        rows.insert(k, rows[i])
    elif how == 2:
        rows[i], rows[k] = rows[k], rows[i]
    else:
        del rows[min(i, k) : max(i, k)]
    return b"\n".join(rows)


def other(data: bytes, by: random.Random) -> bytes:
    """Something else under the name."""
    text = data.decode("utf-8", "replace")
    return by.choice([
        b"", b"\0", b"\n" * 1000, data[:40], by.randbytes(2000), b"<html><body>404</body></html>", b"PK\x03\x04" + by.randbytes(200),
        text.encode("utf-16"), b"\xef\xbb\xbf" + data, data.replace(b"\n", b"\r\n"), data.replace(b".", b","), data + data,
        data + by.randbytes(300), data.upper(), b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 12\n",
        b"solid " + b"a" * 100_000, b"[" * 100_000, b"<" + b"a" * 100_000, b"<a>" * 50_000, b"9" * 1_000_000,
    ])  # fmt: skip


CHANGES: dict[str, Callable[[bytes, random.Random], bytes]] = {
    "number": number, "count": count, "scaled": scaled, "truncated": truncated, "bits": flipped, "swapped": swapped, "word": word,
    "block": block, "lines": lines, "other": other,
}  # fmt: skip


def attack_file(known: dict[str, Input], folder: Path, by: random.Random) -> Outcome:
    """Spoil a file once or twice, and read the problem that names it."""
    form = by.choices(sorted(known), [SLOW if each == "STEP" else 1.0 for each in sorted(known)])[0]
    given = known[form]
    own = folder / f"{by.getrandbits(60):x}"
    own.mkdir()
    data, whats = given.data, []
    for _ in range(by.choice([1, 1, 2])):
        if data:
            whats.append(by.choice([*CHANGES, "number", "number", "count"]))
            data = CHANGES[whats[-1]](data, by)
    try:
        for path in given.beside:
            shutil.copy(folder / path, own / path)
        (own / given.name).write_bytes(data)
        (own / "spoilt.yaml").write_text(given.problem, encoding="utf-8")
        return read(own / "spoilt.yaml", [], f"{form}: {', '.join(whats)}", solved=False, whole=given.whole)
    finally:
        shutil.rmtree(own)


def prepared(folder: Path) -> Case:
    """All inputs, each of which is read as it is."""
    known = inputs()
    for name in ("URDF", "robot", "SVG"):
        (folder / known[name].name).write_bytes(known[name].data)
    for form, given in known.items():
        (folder / given.name).write_bytes(given.data)
        (folder / "true.yaml").write_text(given.problem, encoding="utf-8")
        outcome = read(folder / "true.yaml", [], form, solved=False, whole=given.whole)
        if outcome.verdict != "accepted":
            raise RuntimeError(f"{form} as it is: {outcome.told}")
    return partial(attack_file, known, folder)


KINDS = {"files": Kind("drawings, meshes, faces, waypoints, G-code, robot files", COUNT, prepared)}
