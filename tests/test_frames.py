"""Plans as tables of pandas and xarray, and what is said where these are missing."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from solved import small_plan

from planner.base.errors import InputError


def test_a_data_frame_has_the_columns_and_numbers_of_the_table() -> None:
    plan = small_plan()
    frame, table = plan.to_pandas(), plan.table()
    assert tuple(frame.columns) == table.dtype.names and len(frame) == len(table)
    for name in frame.columns:
        assert (frame[name].to_numpy() == table[name]).all() and frame[name].dtype == table[name].dtype
    assert frame.attrs == {"problem": "small", "strategy": "ladder", "verified": 1}
    laid = frame[frame.deposit]
    assert set(laid.groupby("bead").speed_mm_s.max().index) == {0, 1, 2}


def test_a_data_set_has_time_joints_and_units() -> None:
    plan = small_plan()
    data, table = plan.to_xarray(), plan.table()
    assert dict(data.sizes) == {"t_s": len(table), "joint": len(plan.joint_names)}
    for name in set(table.dtype.names or ()) - {"t_s", *plan.joint_names}:
        assert (data[name].to_numpy() == table[name]).all()
    assert (data.t_s.to_numpy() == plan.t).all() and (data.q.to_numpy() == plan.q).all()
    assert (data.q.sel(joint="joint_5").to_numpy() == plan.q[:, plan.joint_names.index("joint_5")]).all()
    assert set(data.unit.to_numpy()) == {"rad"} and data.x_mm.attrs["units"] == "mm"
    assert bool((data.q >= data.q_min).all()) and bool((data.q <= data.q_max).all())
    assert replace(plan, checks=()).to_xarray().attrs["verified"] == 1  # no check fails: it says what the plan says
    assert np.isfinite(data.speed_mm_s).all()


@pytest.mark.parametrize(("package", "method"), [("pandas", "to_pandas"), ("xarray", "to_xarray")])
def test_a_missing_package_is_named_with_its_extra(package: str, method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(InputError) as error:
        getattr(small_plan(), method)()
    assert str(error.value) == f"Plan.{method} needs the package {package} (pip install 'beadwise[tables]')"
