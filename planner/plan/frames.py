"""A plan's samples as tables of other packages: a data frame of pandas, a data set of xarray."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from planner.base.extras import missing_extra
from planner.plan.measures import COLUMNS

if TYPE_CHECKING:
    import pandas
    import xarray

    from planner.plan.plan import Plan

TIME, JOINT, JOINTS = "t_s", "joint", "q"


def data_frame(plan: Plan) -> pandas.DataFrame:
    """See `Plan.to_pandas`."""
    try:
        import pandas
    except ImportError as error:
        raise missing_extra(error, "Plan.to_pandas") or error from None
    frame = pandas.DataFrame(plan.table())
    frame.attrs.update(_about(plan))
    return frame


def data_set(plan: Plan) -> xarray.Dataset:
    """See `Plan.to_xarray`."""
    try:
        import xarray
    except ImportError as error:
        raise missing_extra(error, "Plan.to_xarray") or error from None
    table, limits = plan.table(), plan.cell.limits
    columns = [name for name in table.dtype.names or () if name not in (TIME, *plan.joint_names)]
    units = ["m" if j in limits.sliding else "rad" for j in range(len(plan.joint_names))]
    variables: dict[str, Any] = {name: (TIME, table[name], _told(name)) for name in columns}
    variables[JOINTS] = ((TIME, JOINT), np.array(plan.q), {"long_name": "joints, each in its unit"})
    variables |= {
        f"{JOINTS}_{end}": (JOINT, np.array(values)) for end, values in (("min", limits.q_min), ("max", limits.q_max))
    }
    places: dict[str, Any] = {
        TIME: (TIME, table[TIME], _told(TIME)),
        JOINT: list(plan.joint_names),
        "unit": (JOINT, units),
    }
    return xarray.Dataset(variables, places, _about(plan))


def _told(name: str) -> dict[str, str]:
    """A column's meaning and unit, under the names that plotting programs expect."""
    return {"long_name": COLUMNS[name].text, "units": COLUMNS[name].unit}


def _about(plan: Plan) -> dict[str, Any]:
    """Attributes of a whole table."""
    return {"problem": plan.name, "strategy": plan.strategy, "verified": int(plan.verified)}
