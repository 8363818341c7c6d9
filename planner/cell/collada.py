"""Read robot meshes from COLLADA files (.dae): triangles with the colours of their materials.

The loader for collision meshes reads neither colours nor the unit. Only these parts of the format are read here: the
unit, positions, polygons, the nodes' matrices, and the diffuse colour of each material. The up axis is left to the
URDF, as in ROS. COLLADA 1.4.1, https://www.khronos.org/collada/.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, Ints

GAMMA = 2.2  # colours of the files are linear, those of screens are not
PALE = (0.8, 0.8, 0.8)  # for a material without a colour


def unit_of(path: Path) -> float:
    """Length of a COLLADA file's unit [m]; 1 if it names none, for other files, and for files that cannot be read."""
    if path.suffix.lower() != ".dae":
        return 1.0
    try:
        with path.open("rb") as file:
            for _, element in ET.iterparse(file):
                tag = element.tag.rsplit("}", 1)[-1]
                if tag == "unit":
                    return float(element.get("meter", "1"))
                if tag == "asset":  # the file's own comes first
                    break
    except (ET.ParseError, OSError, LookupError, ValueError):
        pass  # the error is reported when the rest is read
    return 1.0


def write_without_unit(path: Path, copy: Path) -> None:
    """Write a copy of a COLLADA file without its unit. Raises ValueError for a file that cannot be read."""
    root = _root(path)
    for asset in root.iter("asset"):
        for unit in asset.findall("unit"):
            asset.remove(unit)
    ET.ElementTree(root).write(copy, encoding="utf-8", xml_declaration=True)


def _root(path: Path) -> ET.Element:
    """A file's root element, its tags without their namespace."""
    try:
        root = ET.parse(path).getroot()
    except (ET.ParseError, OSError) as error:
        raise ValueError(f"{path.name} cannot be read") from error
    for element in root.iter():
        element.tag = element.tag.rsplit("}", 1)[-1]
    return root


def read_collada(path: Path) -> tuple[Array, Ints, NDArray[np.uint8]]:
    """Vertices (n, 3) [m], triangles (m, 3), and their colours (m, 3).

    Raises ValueError for a file that shows anything else, or nothing.
    """
    root = _root(path)
    named = {f"#{element.get('id')}": element for element in root.iter() if element.get("id")}
    T = np.diag([*[unit_of(path)] * 3, 1.0])
    vertices, triangles, colours = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int64)], [np.zeros((0, 3))]
    first = 0
    for scene in root.iter("visual_scene"):
        for instance, place in _instances(scene, T):
            geometry = named.get(instance.get("url", ""))
            if geometry is None:
                raise ValueError(f"{path.name} refers to a geometry that it does not contain")
            materials = {
                each.get("symbol", ""): named.get(each.get("target", "")) for each in instance.iter("instance_material")
            }
            for positions, corners, symbol in _polygons(geometry, named):
                vertices.append(positions @ place[:3, :3].T + place[:3, 3])
                triangles.append(corners + first)
                colours.append(np.tile(_diffuse(materials.get(symbol), named), (len(corners), 1)))
                first += len(positions)
    if not first:
        raise ValueError(f"{path.name} has no geometry")
    return np.concatenate(vertices), np.concatenate(triangles), np.round(255 * np.concatenate(colours)).astype(np.uint8)


def _instances(node: ET.Element, T: Array) -> Iterator[tuple[ET.Element, Array]]:
    """Instances of geometries below a node, with their transforms (4, 4)."""
    if any(
        node.find(other) is not None for other in ("translate", "rotate", "scale", "lookat", "skew", "instance_node")
    ):
        raise ValueError("moves that are not written as a matrix")
    for matrix in node.findall("matrix"):
        T = T @ _floats(matrix).reshape(4, 4)
    for instance in node.findall("instance_geometry"):
        yield instance, T
    for child in node.findall("node"):
        yield from _instances(child, T)


def _polygons(geometry: ET.Element, named: dict[str, ET.Element]) -> Iterator[tuple[Array, Ints, str]]:
    """Positions (n, 3), triangles (m, 3) and the material's symbol of each group of polygons."""
    for group in (*geometry.iter("polylist"), *geometry.iter("triangles")):
        inputs = group.findall("input")
        offset = next((int(each.get("offset", "0")) for each in inputs if each.get("semantic") == "VERTEX"), None)
        vertex = next((named.get(each.get("source", "")) for each in inputs if each.get("semantic") == "VERTEX"), None)
        source = None if vertex is None else vertex.find("input[@semantic='POSITION']")
        holder = None if source is None else named.get(source.get("source", ""))
        array, text = (None, None) if holder is None else (holder.find("float_array"), group.find("p"))
        if offset is None or array is None or text is None:
            raise ValueError("polygons without positions")
        stride = 1 + max(int(each.get("offset", "0")) for each in inputs)
        index = np.array((text.text or "").split(), dtype=np.int64).reshape(-1, stride)[:, offset]
        sides = group.find("vcount")
        count = np.full(len(index) // 3, 3) if sides is None else np.array((sides.text or "").split(), dtype=np.int64)
        start = np.repeat(np.cumsum(count) - count, np.maximum(count - 2, 0))
        k = np.arange(len(start)) - np.repeat(np.cumsum(count - 2) - (count - 2), count - 2)
        yield (
            _floats(array).reshape(-1, 3),
            np.column_stack([index[start], index[start + k + 1], index[start + k + 2]]),
            group.get("material", ""),
        )


def _diffuse(material: ET.Element | None, named: dict[str, ET.Element]) -> tuple[float, ...]:
    """A material's colour, three numbers from 0 to 1."""
    link = None if material is None else material.find("instance_effect")
    effect = None if link is None else named.get(link.get("url", ""))
    colour = None if effect is None else effect.find(".//diffuse/color")
    return PALE if colour is None else tuple((np.clip(_floats(colour)[:3], 0.0, 1.0) ** (1.0 / GAMMA)).tolist())


def _floats(element: ET.Element) -> Array:
    return np.array((element.text or "").split(), dtype=np.float64)
