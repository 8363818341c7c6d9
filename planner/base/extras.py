"""Packages that only some commands need: which extra of this package installs them."""

from __future__ import annotations

from planner.base.errors import InputError

# top-level module → extra
EXTRAS = {
    "tornado": "view",
    "requests": "link",
    "websocket": "link",
    "abb_robot_client": "link",
    "google": "link",  # protobuf, which abb_robot_client's messages need
    "dask": "cluster",
    "distributed": "cluster",
    "jupyterlab": "notebooks",
    "pandas": "tables",
    "xarray": "tables",
    "lxml": "meshes",
    "ezdxf": "dxf",
    "networkx": "meshes",
    "xacro": "xacro",
    "xacrodoc": "xacro",
    "rosbags": "bags",
}


def missing_extra(error: ImportError, needed_by: str = "this") -> InputError | None:
    """The error to report if a package of an extra is missing; None if something else is wrong."""
    module = (error.name or "").partition(".")[0]
    if module not in EXTRAS:
        return None
    return InputError(f"{needed_by} needs the package {module}", hint=f"pip install 'beadwise[{EXTRAS[module]}]'")
