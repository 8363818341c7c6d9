"""Several materials in one print: sections `materials` and `change` of `process` in the problem file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from planner.errors import nearest_name
from planner.problem.fields import IDENTIFIER, LONGEST_NAME, Quantity, Section, key

if TYPE_CHECKING:
    from planner.problem import Problem

MaterialName = Annotated[str, IDENTIFIER]
LEAST_WAIT = 0.1  # s: five of the coarsest samples, so that filament of two materials never moves in the same one


def material_key(whose: str, default: str = "the first one there") -> MaterialName | None:
    """The field of a section of `layers` that names a material."""
    text = f"material of {whose}, by its name in process.materials; default: {default}"
    field: MaterialName | None = key("material", text, None)
    return field


class FilamentMoveSpec(Section):
    """Filament that the extruder pushes or pulls while nothing is deposited."""

    length: Annotated[float, Quantity("mm", 0, 100)] = key("length_mm", "of filament [mm]; 0 is none", 0)
    speed: Annotated[float, Quantity("mm/s", 0.1, 200)] = key("speed_mm_s", "of the filament [mm/s]", 25)

    @property
    def time(self) -> float:
        """How long it takes [s]."""
        return self.length / self.speed


class MaterialSpec(Section):
    """One of several materials: the tool that feeds it, and what it needs otherwise than `process` says."""

    tool: Annotated[int, Quantity("", 0, 99, whole=True)] | None = key(
        "tool", "number of its tool in the G-code; default: its place in the list, from 0", None
    )
    extruder_signal: Annotated[str, IDENTIFIER] | None = key(
        "extruder_signal",
        "the digital output of its extruder in RAPID; default: program.extruder_signal, with the tool's number behind "
        "it but for the first one",
        None,
    )
    filament_diameter: Annotated[float, Quantity("mm", 0.5, 10)] | None = key(
        "filament_diameter_mm", "diameter of its filament [mm]; default: process.filament_diameter_mm", None
    )
    nozzle_c: Annotated[float, Quantity("°C", 20, 500)] | None = key(
        "nozzle_c", "temperature of its nozzle [°C]; default: process.start.nozzle_c", None
    )
    prime: FilamentMoveSpec | None = key("prime", "filament pushed until a bead starts; default: process.prime", None)
    retract: FilamentMoveSpec | None = key(
        "retract", "filament pulled back from a bead's end on; default: process.retract", None
    )


class ChangeSpec(Section):
    """What happens at home between beads of two materials."""

    wait: Annotated[float, Quantity("s", LEAST_WAIT, 3600)] = key(
        "wait_s", "time that the robot rests at home while tools are changed [s]", 1
    )
    purge: Annotated[float, Quantity("mm", 0, 1000)] = key(
        "purge_mm", "filament of the new material pushed out then [mm]; 0 is none", 0
    )
    purge_speed: Annotated[float, Quantity("mm/s", 0.1, 200)] = key(
        "purge_speed_mm_s", "speed of the filament in it [mm/s]", 5
    )

    @property
    def time(self) -> float:
        """How long the robot rests at home for a change [s]."""
        return self.wait + self.purge / self.purge_speed


def signals(problem: Problem) -> dict[str, str]:
    """The digital output in RAPID that switches the extruder of each material, by its name."""
    process, found = problem.process, {}
    for i, (name, spec) in enumerate(process.materials.items()):
        usual = problem.program.extruder_signal
        found[name] = spec.extruder_signal or (f"{usual}{process.tool(name)}" if i else usual)
    return found


def check_materials(problem: Problem) -> None:
    """Raise the InputError of a name that is no material's, and of a digital output that has two names or two uses."""
    names = list(problem.process.materials)
    parts = [(f"layers.{part}", getattr(problem.layers, part, None)) for part in ("support", "infill")]
    for field, section in (("layers", problem.layers), *parts):
        name = getattr(section, "material", None)
        if name is not None and name not in names:
            near = nearest_name(name, names)
            hint = f"choices: {', '.join(names)}" if names else "give process.materials, or leave it out"
            reason = f"there is no material {name!r} in process.materials"
            raise problem.error(f"{field}.material", reason, f"did you mean {near}? {hint}" if near else hint)
    program = problem.program
    taken = {getattr(program, use).lower(): f"program.{use}" for use in ("tool", "work_object", "station")}
    for name, signal in signals(problem).items():
        field = f"process.materials.{name}.extruder_signal"
        if len(signal) > LONGEST_NAME:
            raise problem.error(field, f"{signal!r} is too long for RAPID", f"at most {LONGEST_NAME} characters")
        first = taken.setdefault(signal.lower(), name)  # RAPID does not tell capitals from small letters
        if first != name:
            raise problem.error(field, f"{signal!r} is already the name of {first}", "give each its own name")
