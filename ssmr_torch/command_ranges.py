"""Ranges of what stands at the top of the commands' configurations, and of the settings of libraries in them."""

from __future__ import annotations

from ssmr_torch.quantities import ADDRESS, DURATION, LENGTH, PATH, PATIENCE, SEED, TEXT, TRUTH, VECTOR, WAIT, WORKERS
from ssmr_torch.ranges import Anything, ByName, Each, Either, Number, OneOf, OrNone, Range, Text, Whole

PATHS = Either(PATH, Each(PATH), said="the path of an artifact, or a list of paths")
OUTPUTS = OrNone(Each(TEXT))
HORIZONS = Each(DURATION, 1, 1000)
STARTS = Whole(1, 1_000_000)
RUNS = OrNone(Whole(0, 1_000_000))
FORMS = Each(OneOf("c", "torch", "onnx", "casadi"), 0, 4)
BOUNDS = OrNone(Each(Each(Number(-1e12, 1e12), 1, 1000), 2, 2))
UNIT = Number(1e-12, 1e12)

OF_ANY: dict[str, Range] = {"seed": SEED, "figures": TRUTH, "outputs": OUTPUTS}
OF_CONTROLLERS = {"artifact": PATH, "qp": Text("the name of a solver: proxqp, daqp, qpsolvers:NAME or "
                                               "package.module:Class")}

OF_COMMANDS: dict[str, dict[str, Range]] = {
    "collect": {"workers": OrNone(WORKERS)},
    "read": {"files": Either(PATH, Each(PATH), said="the path of a file, or a list of paths"),
             "card": OrNone(PATH)},
    "faults": {"only": Each(TEXT, 0, 100), "repeats": Whole(1, 1000), "time_limit": Number(0.1, 1e6, "s"),
               "progress": TRUTH, **{f"sizes.{size}": Whole(0, 10**9) for size in (
                   "flips", "steps", "frames", "settings", "moments")}},
    "check": {"recordings": OrNone(PATH)},
    "train": {"name": TEXT, "metric": Text("validation/rmse, validation/rmse_50ms, validation/rmse_200ms or "
                                           "validation/relative"), "resume": TRUTH, "save_to": OrNone(PATH),
              "search_minutes": OrNone(Number(1e-3, 1e7, "min")), "study.axis": TEXT, "study.label": TEXT,
              "study.runs": OrNone(PATH), "study.scale": Number(1e-12, 1e12)},
    "compare": {"models": OrNone(Each(TEXT, 1, 100)), "scored": OUTPUTS, "noise": LENGTH, "horizons": HORIZONS,
                "starts": STARTS, "artifacts": TRUTH},
    "export": {"checkpoint": OrNone(PATH), "mat": OrNone(PATH), "length_unit": UNIT, "input_unit": UNIT,
               "state_scale": Number(1e-9, 1e3, "m"), "rest": OrNone(Each(Number(-1e3, 1e3, "m"))),
               "output_names": Each(TEXT), "input_names": OUTPUTS, "name": OrNone(TEXT),
               "formats": OrNone(Either(OneOf("c", "torch", "onnx", "casadi"), FORMS, said=FORMS.said)),
               "artifact": PATH},
    "evaluate": {"artifact": PATHS, "split": OrNone(OneOf("train", "validation", "test")),
                 "kind": OrNone(OneOf("decay", "controlled", "static")), "horizons": HORIZONS,
                 "noise": OrNone(LENGTH), "starts": STARTS},
    "design": {"bounds": BOUNDS, "artifact": PATH, "progress": OrNone(TRUTH)},
    "control": OF_CONTROLLERS | {"residuals": OrNone(PATH), "quantile": OrNone(Number(1e-6, 1 - 1e-6)),
                                 "noise_std": LENGTH, "progress": TRUTH, "picture": TRUTH, "animate": TRUTH},
    "serve_controller": OF_CONTROLLERS | {
        "bind": ADDRESS, "key_file": OrNone(PATH), "runs": RUNS, "deadline": OrNone(WAIT), "timeout": PATIENCE,
        "patience": PATIENCE, "rest_tolerance": Number(1e-9, 100.0, "m")},
    "serve_plant": {
        "connect": ADDRESS, "key_file": OrNone(PATH), "real_time": TRUTH, "runs": RUNS, "wait": OrNone(WAIT),
        "timeout": PATIENCE, "patience": PATIENCE, "answer_within": Number(1e-3, 1.0), "safe_input": VECTOR},
    "commission": {"card": PATH, "confirm": OneOf("ask", "yes")},
    "report": {"directory": PATH, "title": TEXT},
    "reproduce": {"figures": Either(TEXT, Each(TEXT), said="all, the name of a figure, or a list of names"),
                  "recordings": OrNone(PATH), "workers": WORKERS, "preset": ByName(Anything())},
    "delay_study": {"record": OrNone(PATH), "outputs": Each(TEXT), "manifold.delays": Each(Whole(0, 1000), 1, 100),
                    "manifold.state_dim": Whole(1, 500), "manifold.degree": Whole(1, 9),
                    "manifold.control_delays": Whole(0, 1000), "manifold.transient": Number(0.0, 1e4, "s"),
                    "manifold.ridge": Number(0.0, 1e12)},
    "docs_numbers": {"root": PATH, "check": TRUTH, "from": OrNone(PATH), "name": TEXT, "table": OrNone(TEXT),
                     "command": OrNone(Each(TEXT))},
}

OF_LIBRARIES: dict[str, dict[str, Range]] = {
    "lightning.Trainer": {
        "accelerator": OneOf("cpu", "gpu", "auto", "cuda", "mps", "tpu"), "strategy": TEXT,
        "devices": Either(Whole(1, 1024), TEXT, Each(Whole(0, 1024)), said="a whole number from 1 to 1024, auto, or a "
                                                                           "list of devices"),
        "use_distributed_sampler": TRUTH, "enable_model_summary": TRUTH, "enable_progress_bar": TRUTH,
        "log_every_n_steps": Whole(0, 1_000_000), "max_epochs": OrNone(Whole(1, 1_000_000)),
        "precision": Either(OneOf(16, 32, 64), TEXT), "gradient_clip_val": OrNone(Number(0.0, 1e12))},
    "lightning.pytorch.loggers.CSVLogger": {"save_dir": PATH, "name": OrNone(Text()),
                                            "version": Either(Whole(0, 10**9), OneOf(""), TEXT)},
    "lightning.pytorch.loggers.WandbLogger": {"project": TEXT, "save_dir": PATH, "offline": TRUTH},
    "optuna.samplers.TPESampler": {"seed": OrNone(SEED)},
}

