"""Ranges of the quantities that many settings are: a time, a share, a seed, a weight, a degree."""

from __future__ import annotations

from ssmr_torch.ranges import (
    Address,
    Anything,
    ByName,
    Each,
    Either,
    Number,
    OneOrEach,
    OrNone,
    PathText,
    Text,
    Truth,
    Whole,
)

SEED = Whole(0, 2**32 - 1)
TIMESTEP = Number(1e-6, 100.0, "s")
DURATION = Number(1e-3, 1e5, "s")
LENGTH = Number(0.0, 100.0, "m")
SHARE = Number(0.0, 1.0)
POSITIVE_SHARE = Number(1e-6, 1.0)
COUNT = Whole(0, 1_000_000)
TRUTH, TEXT, PATH = Truth(), Text(), PathText()
TRACKED = Each(Either(TEXT, Whole(0, 10_000), said="a name or a column's number"), 1, 1000)
VECTOR = OrNone(Each(Number(-1e12, 1e12), 1, 10_000))
WEIGHT, FREE_WEIGHT = Number(1e-30, 1e40), Number(0.0, 1e40)
OUTPUT_WEIGHT = Number(1e-30, 1e40, "1/m²")
PER_INPUT = OneOrEach(WEIGHT, "input")
FREE_PER_INPUT = OneOrEach(FREE_WEIGHT, "input")
LIMIT = OrNone(OneOrEach(Number(1e-9, 1e15), "input"))
INPUT_BOUNDS = Each(OneOrEach(Number(-1e12, 1e12), "input"), 2, 2)
NOISE = Number(1e-12, 1e9)
PLACES = ByName(Anything())  # a node's number, or a place, which the mesh has to have
OF_RANGE = Number(0.0, 1.0, above=True)
STAY, HELD = Number(0.0, 1e5, "s"), Number(1e-4, 1e5, "s")
CANDIDATES = OneOrEach(Number(0.0, 1e12), "attempt of the cross-validation")
RIDGE = Either(CANDIDATES, ByName(CANDIDATES), said=f"{CANDIDATES.said}, or a mapping of regressions to them")
GUARD = {"margin": Number(0.0, 1e3, "1/s"), "reach": Number(1.0, 1e6, above=True), "overdrive": Number(1.0, 100.0)}
STATES = Either(Whole(1, 500), Text(), said="a whole number from 1 to 500, or a rule such as variance:0.99 or gap")
DELAYS, DEGREE, DEGREE_OR_NONE, SUBSTEPS = Whole(0, 1000), Whole(1, 9), Whole(0, 9), Whole(1, 1000)
MODEL_TIMESTEP = OrNone(TIMESTEP)
WORKERS = Whole(1, 1024)
WAIT, PATIENCE = Number(0.0, 1e7, "s"), Number(1e-3, 1e7, "s")
ADDRESS = Address()
