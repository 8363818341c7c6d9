"""A plan saved, loaded, tabulated with pandas and xarray, and its scene as a page."""

from planner import Plan, load, solve, write

solve(load("peer_cap"), baseline=False).save("cap.npz")

plan = Plan.load("cap.npz")  # to the last bit; runs nothing, whoever made the file
write(plan, "out/cap")  # what was changed in the file would be verified anew

frame = plan.to_pandas()  # pip install 'beadwise[tables]'
laid = frame[frame.deposit]
print(laid.groupby("bead")[["speed_mm_s", "flow_mm3_s"]].describe().T)

data = plan.to_xarray()
spare = (data.q - data.q_min).clip(max=data.q_max - data.q).min("t_s")
print(spare.to_series().rename("least room to an end of the range, rad"))

plan.show().save("scene.html")  # in a notebook plan.show() alone
