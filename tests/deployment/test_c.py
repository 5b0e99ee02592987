"""A model in C: it computes what the model computes, in plain C99, and keeps and allocates nothing."""

import re
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from ctypes import c_void_p
from dataclasses import replace

import numpy as np
import pytest

from ssmr_torch.deployment import artifact
from ssmr_torch.deployment.c.c_text import comment, identifier, table
from ssmr_torch.deployment.c.compiled_library import CLibrary, compile_library, compiler
from ssmr_torch.deployment.c.model_source import write_c
from ssmr_torch.deployment.exported_programs import check_c
from ssmr_torch.deployment.reference_batch import Sought, check, expected, horizon_inputs


def random_batch(model, seed=3, size=9):
    rng = np.random.default_rng(seed)
    z = model.state_scale * rng.uniform(-0.4, 0.4, (size, model.state_dim))
    return {"state": z, "input": rng.uniform(0, 1, (size, model.input_dim)),
            "window": rng.uniform(-0.4, 0.4, (size, model.delays + 1, model.output_dim)),
            "window_input": rng.uniform(0, 1, (size, model.delays, model.input_dim))}


def test_every_function_computes_what_the_model_computes(name, compiled):
    library, model, batch, _, _ = compiled(name)
    assert check_c(library, model, batch) <= 1e-13
    assert check_c(library, model, random_batch(model)) <= 1e-13


@pytest.mark.parametrize("kind", ["control-augmented, saturated", "control-augmented, linear in the state",
                                  "of no name, runge_kutta", "of no name, euler", "of no name, map",
                                  "of no name, lifted anew", "slow-fast, constant curvature",
                                  "slow-fast, averaged coordinates"])
def test_saturated_models_compute_the_same_in_c_outside_the_training_range(kind, compiled):
    library, model = compiled(kind)[:2]
    batch = random_batch(model)
    assert (np.abs(5.0 * batch["state"]) > model.state_scale).any()
    assert check_c(library, model, batch | {"state": 5.0 * batch["state"]}) <= 1e-13


def test_the_file_compiles_without_a_warning_under_strict_c99_and_optimized(name, compiled):
    said, at = compiled(name)[3:]
    assert said == ""
    source = next(at.glob("*.c"))
    strict = [compiler(), "-std=c99", "-O3", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-Wconversion", "-Wshadow",
              "-Wstrict-prototypes", "-c", "-o", str(at / "strict.o"), str(source)]
    done = subprocess.run(strict, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[:2000]


def test_the_object_file_needs_only_the_mathematics_library_and_has_no_changing_globals(name, compiled):
    at = compiled(name)[4]
    if shutil.which("nm") is None:
        pytest.skip("nm is not at hand")
    subprocess.run([compiler(), "-std=c99", "-O2", "-c", "-o", str(at / "model.o"), str(next(at.glob("*.c")))],
                   check=True)
    symbols = [line.split() for line in subprocess.run(["nm", str(at / "model.o")], capture_output=True, text=True,
                                                       check=True).stdout.splitlines()]
    undefined = {parts[-1] for parts in symbols if parts[-2] == "U"}
    assert undefined <= {"tanh", "exp", "sqrt", "memcpy", "memset", "memmove", "_GLOBAL_OFFSET_TABLE_"}
    assert not {parts[-1] for parts in symbols if parts[-2] in "bBdDcC"}
    assert {parts[-1] for parts in symbols if parts[-2] == "T"} == {
        f"ssmr_ours_{function}" for function in ("encode", "decode", "decode_jacobian", "step", "step_jacobians",
                                                 "horizon")}


def test_the_jacobians_are_those_of_central_differences(name, compiled):
    library, model = compiled(name)[:2]
    batch = random_batch(model, seed=4, size=1)
    z, u, distance = batch["state"][0], batch["input"][0], 1e-5
    _, A, B = (part[0] for part in library.step_jacobians(z[None], u[None]))
    C = library.decode_jacobian(z[None])[1][0]
    for matrix, point, at in ((A, z, lambda v: library.step(v, np.broadcast_to(u, (len(v), len(u))))),
                              (B, u, lambda v: library.step(np.broadcast_to(z, (len(v), len(z))), v)),
                              (C, z, library.decode)):
        directions = distance * np.eye(len(point))
        difference = (at(point + directions) - at(point - directions)) / (2 * distance)
        np.testing.assert_allclose(matrix, difference.T, rtol=1e-6, atol=1e-8)


def test_the_state_may_be_stepped_in_place(name, compiled):
    library, model, batch = compiled(name)[:3]
    z, u = batch["state"][0].copy(), batch["input"][0]
    A, B = np.empty((model.state_dim, model.state_dim)), np.empty((model.state_dim, model.input_dim))
    for function, room in (("step", ()), ("step_jacobians", (A, B))):
        state = z.copy()
        library.raw(function)(*(array.ctypes.data_as(c_void_p) for array in (state, u, state, *room)))
        np.testing.assert_allclose(state, model.step(z, u), rtol=1e-12, atol=1e-14)


def test_threads_do_not_disturb_each_other(compiled):
    library, model, batch = compiled("SSMR")[:3]
    sought = [library.horizon(z, batch["input"]) for z in batch["state"]]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda k: library.horizon(batch["state"][k % 16], batch["input"]), range(64)))
    for k, parts in enumerate(found):
        for part, alone in zip(parts, sought[k % 16]):
            np.testing.assert_array_equal(part, alone)


def test_a_horizon_of_no_steps_is_the_state_and_its_outputs(compiled):
    library, model, batch = compiled("SSMR")[:3]
    states, A, B, outputs, C = library.horizon(batch["state"][0], np.zeros((0, model.input_dim)))
    np.testing.assert_array_equal(states, batch["state"][:1])
    np.testing.assert_allclose(outputs, model.decode(batch["state"][:1]), rtol=1e-13)
    assert A.shape == (0, 6, 6) and B.shape == (0, 6, 4) and C.shape == (1, 3, 6)


def test_the_reference_horizon_ends_where_the_model_diverges(compiled):
    model, batch = compiled("SSMR")[1:3]
    assert horizon_inputs(model, batch)[1].shape == batch["input"].shape
    assert horizon_inputs(model, batch | {"state": 1e3 * batch["state"]})[1].shape == (0, 4)


def test_a_cpp_program_can_include_the_header(compiled):
    at = compiled("SSMR")[4]
    if shutil.which("g++") is None:
        pytest.skip("no C++ compiler is at hand (g++)")
    (at / "main.cpp").write_text('#include "ssmr_ours.h"\nint main() { double z[SSMR_OURS_STATE_DIM] = {}; double '
                                 'y[SSMR_OURS_OUTPUT_DIM]; ssmr_ours_decode(z, y); return y[0] != 0.0; }\n')
    subprocess.run(["g++", "-Wall", "-Werror", "-o", str(at / "main"), str(at / "main.cpp"), str(at / "model.so"),
                    f"-Wl,-rpath,{at}"], check=True)
    assert subprocess.run([str(at / "main")]).returncode == 0


def test_the_header_says_what_goes_in_and_what_comes_out(artifacts):
    loaded = artifact.load(artifacts("SSMR"))
    header = write_c(loaded.model, loaded.card).header
    assert loaded.card["sha256"]["tables.safetensors"] in header
    assert "outputs, m from rest: y0, y1, y2; rest: 0.1, 0.1, 0.1" in header and "inputs, N: u0 0 to 1" in header
    assert "#define SSMR_OURS_TIMESTEP 0.02 " in header and "#define SSMR_OURS_DELAYS 3\n" in header
    assert re.search(r"stack, about \d+\.\d kB", header)


def test_literals_read_back_to_the_same_double():
    rng = np.random.default_rng(0)
    values = np.concatenate([rng.normal(size=500) * 10.0 ** rng.integers(-300, 300, 500),
                             [0.0, -0.0, 1 / 3, 5e-324, np.finfo(float).max]])
    literals = table("t", values, "numbers").split("{\n")[1].split("};")[0].replace("\n", "").split(",")
    np.testing.assert_array_equal(np.array([float(each) for each in literals]).view(np.int64), values.view(np.int64))
    assert all("." in each or "e" in each for each in literals)


@pytest.mark.parametrize(("given", "prefix"), [("SSMR (published)", "ssmr_published"), ("3 modes", "model_3_modes"),
                                               ("α", "model"), ("DMD", "dmd")])
def test_any_name_becomes_a_c_name(given, prefix):
    assert identifier(given) == prefix


def test_no_text_of_the_card_can_end_a_comment():
    assert comment("a */ int x; /* b\nc ?\\?/ ä") == "a * / int x; / * b c ?/?/ ?"


def test_a_model_that_names_no_writer_is_refused_with_what_to_do(artifacts, foreign):
    with pytest.raises(ValueError, match="a Foreign cannot be written in C.* Leave c out .*, or set its c_source"):
        write_c(foreign, artifact.load(artifacts("SSSR")).card)


def test_a_difference_is_refused_with_both_numbers():
    one = Sought(np.array([1.0, 2.0]), 1e-12)
    assert check("c", [("next", np.array([1.0, 2.0 + 4e-13]), one)]) == pytest.approx(2e-13, rel=1e-2)
    with pytest.raises(ValueError, match="c: next differs from the model's by 2e-12 relative; at most 1e-12"):
        check("c", [("next", np.array([1.0, 2.0 + 4e-12]), one)])
    with pytest.raises(ValueError, match="differs from the model's by nan relative"):
        check("c", [("next", np.array([1.0, np.nan]), one)])
    with pytest.raises(ValueError, match=r"c: next has the shape \(3,\); expected \(2,\)"):
        check("c", [("next", np.ones(3), one)])


def test_only_differences_as_large_as_the_models_own_rounding_are_allowed(compiled):
    model, batch = compiled("SSMR")[1:3]
    assert {sought.tolerance for sought in expected(model, batch).values()} == {1e-12}
    chart = np.zeros_like(model.chart)
    chart[:, 0], chart[:, 1] = 1.0, -1.0  # z = w_1 - w_2, of windows where the two differ by a millionth
    window = batch["window"].copy()
    window[:, 0, 1] = window[:, 0, 0] * (1.0 - 1e-6)
    found = expected(replace(model, chart=chart), batch | {"window": window})
    assert 1e-10 < found["encode"].tolerance < 1e-8 and found["step"].tolerance == 1e-12


@pytest.mark.skipif(compiler() is None, reason="no C compiler")
def test_a_function_may_need_more_stack_than_a_process_has(tmp_path):
    (tmp_path / "deep.c").write_text("""
void deep_step(const double *z, const double *u, double *next)
{
    double work[4 << 20];  /* 32 MB */
    int i;
    for (i = 0; i < 4 << 20; i++)
        work[i] = z[0] + u[0];
    next[0] = work[i - 1];
}
""")
    compile_library(tmp_path / "deep.c", tmp_path / "deep.so")
    library = CLibrary(tmp_path / "deep.so", "deep", None)
    assert library.call("step", ([1.0], [2.0]), [(1,)])[0] == 3.0
