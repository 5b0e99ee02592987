"""What the paper prints and claims, table by table and figure by figure. SI units; each number with its source."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

OURS = ("SSMR", "SSSR", "control-augmented SSMR")  # learned on spectral submanifolds, ours the last
METHODS = (*OURS, "DMD", "EDMD", "static pregain", "TPWL", "neural ODE")  # in the order of tables and figures
SIMULATED = ("SSMR", "SSSR", "DMD", "EDMD", "TPWL")


class Model(NamedTuple):
    """A row of Table 1: state dimension; controlled transitions, and decays or set points beside them; delays of the
    observable, None where the model has no delays.
    """

    dimension: int
    transitions: int
    others: int
    delays: int | None


@dataclass(frozen=True)
class Published:
    """title: of the table or figure; protocol: how the paper made it; claim: what it says came out; methods: those
    that the claim is about; robot: of the open loop; here: how a reproduction makes it, where no number is needed.
    """

    title: str
    protocol: str
    claim: str
    methods: tuple[str, ...] = SIMULATED
    robot: str = ""
    here: str = ""


# Table 1; "emulated_bench" stands for the paper's experiment with the real diamond
TABLE_1 = {
    "diamond": {"SSMR": Model(6, 8692, 40, 1), "SSSR": Model(6, 8692, 40, 1), "DMD": Model(11, 8692, 0, 1),
                "EDMD": Model(66, 8692, 0, 1), "TPWL": Model(42, 4352, 0, None)},
    "trunk": {"SSMR": Model(6, 4201, 40, 1), "SSSR": Model(6, 4201, 40, 1), "DMD": Model(15, 7111, 0, 1),
              "EDMD": Model(120, 7111, 0, 1), "TPWL": Model(28, 9711, 0, None)},
    "emulated_bench": {"SSMR": Model(6, 16560, 34, 1), "SSSR": Model(6, 16560, 34, 1), "EDMD": Model(66, 34098, 0, 1),
                 "static pregain": Model(6, 34098, 291, 1), "TPWL": Model(42, 43522, 0, None)},
}
# m: mean RMSE over 50 ms from 500 starts; captions of Fig. 4 (diamond) and Fig. 5 (trunk)
OPEN_LOOP = {
    "diamond": {"SSMR": 0.492e-3, "SSSR": 0.457e-3, "DMD": 3.104e-3, "EDMD": 2.962e-3, "TPWL": 0.317e-3},
    "trunk": {"SSMR": 0.54e-3, "SSSR": 2.60e-3, "DMD": 4.24e-3, "EDMD": 3.68e-3, "TPWL": 1.90e-3},
}
SPEED = {"diamond": 74.7e-3, "trunk": 30.3e-3}  # m/s, mean speed of these runs; text before Fig. 4
# m, RMSE read off the authors' plots of Fig. 6 and Fig. 7, so approximate; which figure eight is not said
TRACKING = {
    ("diamond", "figure eight"): {"SSMR": 0.23e-3, "SSSR": 0.17e-3, "EDMD": 0.16e-3, "DMD": 0.31e-3, "TPWL": 0.73e-3},
    ("trunk", "ASL"): {"SSMR": 0.55e-3, "SSSR": 2.0e-3, "EDMD": 2.0e-3, "DMD": 1.95e-3, "TPWL": 1.8e-3},
}
# s per program, read off the authors' plots of Fig. 8, so approximate
SOLVE_TIME = {
    "diamond": {"SSMR": 8e-3, "SSSR": 0.7e-3, "DMD": 0.45e-3, "EDMD": 5e-3},
    "trunk": {"SSMR": 8e-3, "SSSR": 0.7e-3, "DMD": 0.45e-3, "EDMD": 50e-3},
}
ACCURACY_FACTOR, TRACKING_FACTOR = 6.0, 150.0  # the introduction: up to so many times better than the baselines

FIGURES = {
    "table1": Published(
        "Table 1: the models",
        "The paper learns SSMR and SSSR from decays and controlled transitions, the linear baselines from the latter, "
        "and takes TPWL from the finite-element equations.",
        "SSMR is of the lowest dimension on every robot.",
        here="Here all are trained on the same trajectories of a robot."),
    "fig3": Published(
        "Figure 3: delays and the manifold under control",
        "A controlled run is passed through chart and parametrization of manifolds that were learned from decays with "
        "4 to 20 delays, as they are and reparametrized to one delay.",
        "Without reparametrization the reconstruction shrinks as delays are added; with it, it hardly changes.", (),
        here="Here the error stands beside the ratio of norms, which the paper calls reconstruction."),
    "fig4": Published(
        "Figure 4: open-loop error over the diamond's workspace",
        "The simulated diamond is driven by inputs unlike those in training, at a mean speed of 74.7 mm/s, and every "
        "model is rolled out over 50 ms from 500 samples of that run.",
        "SSMR and SSSR are below DMD and EDMD.", robot="diamond"),
    "fig5": Published(
        "Figure 5: open-loop error over the trunk's workspace",
        "The simulated trunk is driven by inputs unlike those in training, at a mean speed of 30.3 mm/s, and every "
        "model is rolled out over 50 ms from 500 samples of that run.",
        "SSMR is below all others.", robot="trunk"),
    "fig6": Published(
        "Figure 6: the diamond in closed loop",
        "The tip follows a slow and a fast figure eight of 10 s, controlled at 50 Hz with a horizon of 100 ms.",
        "SSMR has the lowest ISE in both tasks."),
    "fig7": Published(
        "Figure 7: the trunk in closed loop",
        "The tip writes ASL and traces Pacman within 10 s each, controlled at 50 Hz with a horizon of 100 ms.",
        "SSMR has the lowest ISE in both tasks."),
    "fig8": Published(
        "Figure 8: accuracy against computing time",
        "ISE of the closed loops is plotted over the time of one program divided by the control period of 20 ms.",
        "SSMR and SSSR lie on the Pareto front of every task."),
    "fig9": Published(
        "Figure 9: the trunk among obstacles",
        "The tip writes ETH within 10 s among 20 random circles, with a horizon of 60 ms, for 100 sets of circles.",
        "SSMR has the lowest ISE, is inside obstacles the least and the least deep.", ("SSMR", "SSSR", "EDMD", "TPWL")),
    "fig10": Published(
        "Figure 10: the diamond on its bench",
        "The paper shows its robot, motors that pull cables at a silicone diamond and cameras that see its tip, and "
        "the three tasks.", "", (),
        here="Here the bench is emulated: another stiffness than the model's, and the sensors and motors of a rig. "
             "Where recordings of the real one are given, models of them are scored in the open loop."),
    "fig11": Published(
        "Figure 11: the diamond on its bench in closed loop",
        "A quasi-static figure eight and a quasi-static circle, ten runs of each model, at the control rate that each "
        "can hold in real time.",
        "SSMR and SSSR have a lower ISE than every baseline.", ("SSMR", "SSSR", "EDMD", "static pregain", "TPWL")),
    "fig12": Published(
        "Figure 12: the diamond on its bench among obstacles",
        "The tip writes Stanford's S among six circles, ten runs of each model, at the control rate that each can hold "
        "in real time.",
        "SSMR has the lowest ISE, is inside obstacles the least and the least deep.", ("SSMR", "SSSR", "EDMD", "TPWL")),
}
