"""Files of facets in every format that is read: units, scale, several bodies, sizes that are no part's, and damaged ones."""

from __future__ import annotations

import io
import struct
import sys
import zipfile
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.problem.mesh_files import read_corners, read_facets, unit_of
from planner.problem.part import UNITS, MeshSpec

SIDES = (40.0, 30.0, 20.0)
KINDS = ("stl", "stl_ascii", "ply", "ply_ascii", "obj", "off")


def box(sides: tuple[float, float, float] = SIDES) -> trimesh.Trimesh:
    return trimesh.creation.box(sides)


def written(mesh: trimesh.Trimesh, kind: str) -> bytes:
    data = mesh.export(file_type="ply", encoding="ascii") if kind == "ply_ascii" else mesh.export(file_type=kind)
    return data.encode() if isinstance(data, str) else bytes(data)


def save(folder: Path, kind: str, mesh: trimesh.Trimesh) -> Path:
    path = folder / f"part.{kind.partition('_')[0]}"
    path.write_bytes(written(mesh, kind))
    return path


def spec_of(path: Path, **more: object) -> MeshSpec:
    usual = {"unit": None, "scale": 1.0, "origin": (0.0, 0.0, 0.0), "rpy": (0.0, 0.0, 0.0), "smooth": None}
    return MeshSpec.model_construct(file=path, **{**usual, **more})


def sizes(path: Path, **more: object) -> Array:
    corners = read_facets(spec_of(path, **more), partial(InputError, file=path))
    return np.asarray(np.ptp(corners.reshape(-1, 3), axis=0) * 1e3)


@pytest.mark.parametrize("kind", KINDS)
def test_every_format_gives_the_same_body(tmp_path: Path, kind: str) -> None:
    path = save(tmp_path, kind, box())
    np.testing.assert_allclose(sizes(path), SIDES, atol=1e-4)
    corners = read_corners(path, partial(InputError, file=path))
    assert corners.shape == (12, 3, 3)
    a, b, c = corners.transpose(1, 0, 2)
    assert (a * np.cross(b, c)).sum() / 6.0 == pytest.approx(np.prod(SIDES) * 1e-9, rel=1e-6)


def test_a_text_is_read_whatever_its_bodies_are_called(tmp_path: Path) -> None:
    text = box().export(file_type="stl_ascii").replace("solid", "solid Vertex of facet normal 1")
    (tmp_path / "part.stl").write_text(text)
    np.testing.assert_allclose(sizes(tmp_path / "part.stl"), SIDES, rtol=1e-5)


def test_squares_of_an_obj_are_two_facets_each_whatever_its_groups(tmp_path: Path) -> None:
    lines = [f"v {x} {y} {z}" for x in (0, 40) for y in (0, 40) for z in (0, 40)]
    squares = ("1 3 7 5", "2 6 8 4", "1 5 6 2", "3 4 8 7", "1 2 4 3", "5 7 8 6")
    for i, square in enumerate(squares):
        lines += [f"g side{i}", "usemtl red", "f " + " ".join(f"{n}//1" if i % 2 else n for n in square.split())]
    (tmp_path / "part.obj").write_text("mtllib none.mtl\nvn 0 0 1\n" + "\n".join(lines))
    np.testing.assert_allclose(sizes(tmp_path / "part.obj"), [40, 40, 40])


L_SHAPED = np.array(
    [(20, 0), (20, 10), (10, 10), (10, 20), (0, 20), (0, 10), (0, 0), (10, 0)]
)  # two corners are straight


@pytest.mark.parametrize("first", [0, 2])
@pytest.mark.parametrize("kind", ["obj", "off", "ply", "binary.ply"])
def test_facets_that_are_not_convex_are_cut_right_or_refused(tmp_path: Path, kind: str, first: int) -> None:
    """From the corner that turns the other way, facets are seen whole."""
    n, path = len(L_SHAPED), tmp_path / f"part.{kind}"
    rim = np.roll(L_SHAPED, -first, axis=0)
    corners = np.vstack([np.column_stack([rim, np.full(n, z)]) for z in (0, 5)])
    ends = [(np.roll(np.arange(n), -1)[::-1]).tolist(), list(range(n, 2 * n))]
    walls = [[i, (i + 1) % n, (i + 1) % n + n, i + n] for i in range(n)]
    facets = ends if kind == "binary.ply" else ends + walls
    lines = [" ".join(map(str, corner)) for corner in corners]
    listed = [" ".join(map(str, [len(facet), *facet])) for facet in facets]
    head = f"ply\nformat {{}} 1.0\nelement vertex {2 * n}\nproperty float x\nproperty float y\nproperty float z\n"
    head += f"element face {len(facets)}\nproperty list uchar int vertex_indices\nend_header\n"
    if kind == "obj":
        path.write_text(
            "\n".join([f"v {each}" for each in lines] + ["f " + " ".join(str(k + 1) for k in f) for f in facets])
        )
    elif kind == "off":
        path.write_text("\n".join(["OFF # by hand", f"{2 * n} {len(facets)} 0", *lines, *listed]))
    elif kind == "ply":
        path.write_text(head.format("ascii") + "\n".join([*lines, *listed]) + "\n")
    else:
        packed = b"".join(struct.pack(f"<B{n}i", n, *facet) for facet in facets)
        path.write_bytes(head.format("binary_little_endian").encode() + corners.astype("<f4").tobytes() + packed)
    if first == 0:
        with pytest.raises(InputError, match="has a facet of 8 corners that is not convex"):
            sizes(path)
        return
    a, b, c = read_corners(path, partial(InputError, file=path)).transpose(1, 0, 2)
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() * 1e6
    assert area == pytest.approx(2 * 300.0 + (0.0 if kind == "binary.ply" else 80.0 * 5.0))


@pytest.mark.parametrize("unit", UNITS)
def test_units_and_scale(tmp_path: Path, unit: str) -> None:
    in_unit = tuple(side / UNITS[unit] for side in SIDES)
    path = save(tmp_path, "ply", box(in_unit))
    np.testing.assert_allclose(sizes(path, unit=unit), SIDES, rtol=1e-5)
    np.testing.assert_allclose(sizes(path, unit=unit, scale=2.0), 2.0 * np.array(SIDES), rtol=1e-5)


@pytest.mark.parametrize(("factor", "said"), [(1e-3, "unit: m makes it 40 mm"), (1 / 25.4, "unit: in makes it 40 mm")])
def test_a_size_that_is_no_parts_names_the_unit_that_would_do(tmp_path: Path, factor: float, said: str) -> None:
    path = save(tmp_path, "stl", box(tuple(factor * side for side in SIDES)))
    with pytest.raises(InputError, match="mm across, with lengths in mm") as caught:
        sizes(path)
    assert said in str(caught.value)
    assert "unit: mm keeps that size" in str(caught.value)
    np.testing.assert_allclose(sizes(path, unit="mm"), factor * np.array(SIDES), rtol=1e-4)
    with pytest.raises(InputError, match=r"is 4e\+04 mm across at scale 1000"):
        sizes(save(tmp_path, "stl", box()), scale=1000.0)


def in_3mf(unit: str | None, mesh: trimesh.Trimesh, places: tuple[float, ...] = (0.0,)) -> bytes:
    """A 3MF file of bodies at several x."""
    name = "" if unit is None else f' unit="{unit}"'
    vertices = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in mesh.vertices)
    facets = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in mesh.faces)
    items = "".join(f'<item objectid="1" transform="1 0 0 0 1 0 0 0 1 {x} 0 0"/>' for x in places)
    model = (
        f'<?xml version="1.0"?><model{name} xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">'
        f'<resources><object id="1" type="model"><mesh><vertices>{vertices}</vertices><triangles>{facets}</triangles>'
        f"</mesh></object></resources><build>{items}</build></model>"
    )
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("3D/3dmodel.model", model)
    return stream.getvalue()


@pytest.mark.parametrize(("unit", "key"), [(None, "mm"), ("millimeter", "mm"), ("inch", "in"), ("meter", "m")])
def test_a_3mf_says_its_unit(tmp_path: Path, unit: str | None, key: str) -> None:
    path = tmp_path / "part.3mf"
    path.write_bytes(in_3mf(unit, box(tuple(side / UNITS[key] for side in SIDES))))
    assert unit_of(path, partial(InputError, file=path)) == key
    pytest.importorskip("lxml")
    pytest.importorskip("networkx")
    np.testing.assert_allclose(sizes(path), SIDES, rtol=1e-6)


def test_bodies_of_a_3mf_stand_where_they_are_put(tmp_path: Path) -> None:
    pytest.importorskip("lxml")
    pytest.importorskip("networkx")
    path = tmp_path / "part.3mf"
    path.write_bytes(in_3mf("millimeter", box(), (0.0, 60.0)))
    np.testing.assert_allclose(sizes(path), [100.0, *SIDES[1:]], rtol=1e-6)


@pytest.mark.parametrize(("numbers", "parts"), [((1, 3), (0, 1)), ((1, 3), (0, 0)), ((1, 1), (0, 1))])
def test_parts_of_a_3mf_are_read_where_their_bodies_are_told_apart(
    tmp_path: Path, numbers: tuple[int, int], parts: tuple[int, int]
) -> None:
    """An assembly of two bodies, each in a part of its own or both in one, as Bambu Studio saves them."""
    pytest.importorskip("lxml")
    pytest.importorskip("networkx")
    path, files = tmp_path / "part.3mf", ["3D/Objects/a.model", "3D/Objects/b.model"]
    with zipfile.ZipFile(io.BytesIO(in_3mf(None, box()))) as archive:
        alone = archive.read("3D/3dmodel.model").decode()
    head, found, _ = alone.partition("<resources>")
    body = alone[alone.index("<object") : alone.index("</resources>")]
    made = [body.replace('id="1"', f'id="{number}"') for number in numbers]
    held = ["".join(each for each, part in zip(made, parts, strict=True) if part == k) for k in range(2)]
    used = "".join(
        f'<component p:path="/{files[part]}" objectid="{number}" transform="1 0 0 0 1 0 0 0 1 {60 * k} 0 0"/>'
        for k, (number, part) in enumerate(zip(numbers, parts, strict=True))
    )
    production = ' xmlns:p="http://schemas.microsoft.com/3dmanufacturing/production/2015/06">'
    assembly = f'<object id="9" type="model"><components>{used}</components></object></resources>'
    with zipfile.ZipFile(path, "w") as archive:
        build = '<build><item objectid="9"/></build></model>'
        archive.writestr("3D/3dmodel.model", head[:-1] + production + found + assembly + build)
        for file, bodies in zip(files, held, strict=True):
            archive.writestr(file, f"{head}{found}{bodies}</resources><build/></model>")
    if len(set(numbers)) == len(set(parts)) == 2:
        np.testing.assert_allclose(sizes(path), [100.0, *SIDES[1:]], rtol=1e-6)
        return
    with pytest.raises(InputError, match=r"bodies in the parts of part\.3mf cannot be told apart"):
        sizes(path)


def test_a_missing_package_is_named_with_its_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "lxml", None)
    monkeypatch.setitem(sys.modules, "lxml.etree", None)
    path = tmp_path / "part.3mf"
    path.write_bytes(in_3mf(None, box()))
    with pytest.raises(InputError, match="a 3MF file needs the package lxml") as caught:
        sizes(path)
    assert "pip install 'beadwise[meshes]'" in str(caught.value)


DAMAGED = {
    "points only": ("part.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
                    b"property float z\nend_header\n0 0 0\n", "holds no facets"),
    "no corner": ("part.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "damaged|not in OBJ format"),
    "nothing": ("part.obj", b"v 0 0 0\n", "holds no facets"),
    "one coordinate": ("part.obj", b"v 0\nv 1\nv 2\nf 1 2 3\n", "three coordinates|not in OBJ format"),
    "cut off": ("part.ply", written(box(), "ply")[:-20], "damaged|not in PLY format"),
    "no zip": ("part.3mf", b"PK\x03\x04 and nothing", "3MF"),
    "off": ("part.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n", "not in OFF format"),
}  # fmt: skip


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_files_are_named(tmp_path: Path, name: str) -> None:
    file, data, said = DAMAGED[name]
    (tmp_path / file).write_bytes(data)
    with pytest.raises(InputError, match=said) as caught:
        sizes(tmp_path / file)
    assert file in str(caught.value)


@settings(max_examples=60)
@given(
    kind=st.sampled_from(KINDS),
    cut=st.floats(0.0, 1.0),
    changes=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), max_size=6),
)
def test_whatever_a_file_holds_it_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, kind: str, cut: float, changes: list[tuple[float, int]]
) -> None:
    data = bytearray(written(box(), kind))
    for place, value in changes:
        data[int(place * (len(data) - 1))] = value
    path = tmp_path_factory.mktemp("mesh") / f"part.{kind.partition('_')[0]}"
    path.write_bytes(bytes(data[: max(int(cut * len(data)), 1)] if cut < 0.7 else data))
    try:
        assert np.isfinite(sizes(path)).all()
    except InputError as error:
        assert path.name in str(error)
