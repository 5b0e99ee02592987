"""A chain of rigid links and soft universal joints, bent by four tendons, simulated by MuJoCo."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssmr_torch.checked_arguments import checked
from ssmr_torch.extras import require
from ssmr_torch.periods import whole_multiple
from ssmr_torch.plants.base import input_range
from ssmr_torch.plants.flat_state import FlatStatePlant
from ssmr_torch.quantities import INPUT_BOUNDS, TIMESTEP
from ssmr_torch.ranges import Number, Whole

GRAVITY = 9.81  # m/s²
SIDES = {"+x": (1.0, 0.0), "-x": (-1.0, 0.0), "+y": (0.0, 1.0), "-y": (0.0, -1.0)}
OUTPUTS = ("tip_x", "tip_y", "tip_z", "middle_x", "middle_y", "middle_z")


class TendonChain(FlatStatePlant):
    """Vertebrae that hang in a row, each on a universal joint with a spring and a damper; four tendons bend the chain.

        M(q) q̈ + h(q, q̇) + k q + c q̇ = −(∂ℓ/∂q)ᵀ u,

    q: (2 links,) rad.   ℓ(q): (4,) m, lengths of the tendons along straight lines from hole to hole.   u ≥ 0: N.
    M, h with gravity, and ℓ by MuJoCo, whose integrator "implicitfast" takes the damping implicitly.

    links: number of vertebrae.   length: m, of the chain.   mass: kg, of printed discs and backbone together.
    radius: m, of the circle of holes; a vertebra is a disc of this radius.   stiffness k: N m/rad of one joint, a rod
    of silicone (1.5 MPa) of 12 mm, E I / (length of a link).   damping c: N m s/rad.   substep: s, of MuJoCo.
    payload: kg, a point at the tip.   input_bounds: N.   state: (4 links,), q and q̇.   Outputs: tip and middle of the
    chain, z up, from the base.
    Needs the extra `robots`.
    """

    name, input_unit, ENGINE = "tendon chain", "N", ("_model", "_data")
    output_names, input_names = OUTPUTS, tuple(f"tendon_{side}" for side in SIDES)

    @checked(links=Whole(1, 200), length=Number(1e-4, 100.0, "m"), mass=Number(1e-6, 1e4, "kg"),
             radius=Number(1e-4, 100.0, "m"), stiffness=Number(0.0, 1e6, "N m/rad"),
             damping=Number(0.0, 1e6, "N m s/rad"), timestep=TIMESTEP, input_bounds=INPUT_BOUNDS,
             substep=Number(1e-6, 1.0, "s"), gravity=Number(-1e3, 1e3, "m/s²"), payload=Number(0.0, 1e4, "kg"))
    def __init__(self, *, links: int = 12, length: float = 0.192, mass: float = 0.03, radius: float = 0.012,
                 stiffness: float = 0.095, damping: float = 0.006, timestep: float = 0.01, substep: float = 0.001,
                 input_bounds: Sequence = (0.0, 1.2), gravity: float = GRAVITY, payload: float = 0.0):
        require("mujoco")
        if not (links >= 2 and links % 2 == 0 and min(length, mass, radius) > 0 <= min(stiffness, damping)):
            raise ValueError(f"links is {links}, length {length} m, mass {mass} kg, radius {radius} m, stiffness "
                             f"{stiffness} N m/rad, damping {damping} N m s/rad; expected an even number of links and "
                             "positive values")
        if not 0 <= payload < np.inf:
            raise ValueError(f"payload is {payload} kg; expected 0 or more")
        self.timestep = float(timestep)
        self.substeps = whole_multiple("timestep", timestep, "substep", substep)
        self.input_bounds = input_range(input_bounds, len(SIDES), self.input_unit)
        self.parameters = {"links": links, "length": length, "mass": mass, "radius": radius, "stiffness": stiffness,
                           "damping": damping, "timestep": timestep, "substep": substep,
                           "input_bounds": self.input_bounds.tolist(), "gravity": gravity, "payload": payload}
        self._build()
        self._settle(np.zeros(4 * links))

    def _build(self) -> None:
        import mujoco

        of = self.parameters
        self._model = mujoco.MjModel.from_xml_string(_description(
            **{name: of[name] for name in of if name not in ("timestep", "input_bounds")}))
        self._data = mujoco.MjData(self._model)

    def energy(self) -> float:
        """Kinetic and potential energy, J; without tension in the tendons it never grows."""
        import mujoco

        self._put(self._state)
        mujoco.mj_forward(self._model, self._data)
        return float(self._data.energy.sum())

    def _put(self, state: np.ndarray) -> None:
        self._data.qpos[:], self._data.qvel[:] = np.split(state, 2)

    def _flow(self, state: np.ndarray, u: np.ndarray, substeps: int) -> np.ndarray:
        import mujoco

        self._put(state)
        self._data.time, self._data.ctrl[:] = 0.0, u
        mujoco.mj_step(self._model, self._data, substeps)
        return np.concatenate([self._data.qpos, self._data.qvel])

    def _observe(self, state: np.ndarray) -> np.ndarray:
        import mujoco

        self._put(state)
        mujoco.mj_kinematics(self._model, self._data)
        return np.concatenate([self._data.site("tip").xpos, self._data.site("middle").xpos])


def _description(links: int, length: float, mass: float, radius: float, stiffness: float, damping: float,
                 substep: float, gravity: float, payload: float) -> str:
    """The model as MuJoCo's XML. Every vertebra has holes at both faces, so that a tendon is straight in between."""
    link = length / links
    holes = {side: [f'<site site="{side} base"/>'] for side in SIDES}
    base = "".join(f'<site name="{side} base" pos="{radius * x} {radius * y} 0"/>' for side, (x, y) in SIDES.items())
    opened = ""
    for i in range(links):
        sites = ""
        for side, (x, y) in SIDES.items():
            for face, depth in (("upper", 0.25), ("lower", 0.75)):
                name = f"{side} {face} {i}"
                sites += f'<site name="{name}" pos="{radius * x} {radius * y} {-depth * link}"/>'
                holes[side].append(f'<site site="{name}"/>')
        name = {links // 2 - 1: "middle", links - 1: "tip"}.get(i)
        marker = f'<site name="{name}" pos="0 0 {-link}"/>' if name else ""
        if name == "tip" and payload:
            marker += f'<geom type="sphere" size="1e-3" pos="0 0 {-link}" mass="{payload}"/>'
        opened += (f'<body pos="0 0 {0.0 if i == 0 else -link}"><joint axis="1 0 0"/><joint axis="0 1 0"/>'
                   f'<geom type="cylinder" size="{radius} {link / 4}" pos="0 0 {-link / 2}" mass="{mass / links}"/>'
                   f"{sites}{marker}")
    tendons = "".join(f'<spatial name="{side}">{"".join(passed)}</spatial>' for side, passed in holes.items())
    motors = "".join(f'<motor tendon="{side}" gear="-1"/>' for side in SIDES)
    return (f'<mujoco><option timestep="{substep}" gravity="0 0 {-gravity}" integrator="implicitfast">'
            f'<flag contact="disable" energy="enable"/></option>'
            f'<default><joint type="hinge" stiffness="{stiffness}" damping="{damping}"/></default>'
            f'<worldbody>{base}{opened}{"</body>" * links}</worldbody>'
            f"<tendon>{tendons}</tendon><actuator>{motors}</actuator></mujoco>")
