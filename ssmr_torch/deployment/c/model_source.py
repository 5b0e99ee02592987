"""Writes a model as one C99 file and its header, from its NumPy arrays alone."""

from __future__ import annotations

import re
from typing import NamedTuple

from ssmr_torch.deployment.c.c_text import Family, comment, identifier
from ssmr_torch.lazy import found
from ssmr_torch.models.base import Model

HEADER = """\
/* {title}

   {lines}

   Matrices are stored row by row. Every function is re-entrant: it keeps and allocates nothing; its scratch memory is
   on the stack, about {stack}. Outputs may not overlap inputs, but next may be z. Nothing is checked: for a state that
   is not finite, or an input outside the training range, the functions return what the equations give.
*/
#ifndef MODEL_H
#define MODEL_H

#ifdef __cplusplus
extern "C" {{
#endif

#define MODEL_STATE_DIM {n}
#define MODEL_INPUT_DIM {m}
#define MODEL_OUTPUT_DIM {p}
#define MODEL_DELAYS {delays}
#define MODEL_TIMESTEP {timestep}         /* s, of one step */
#define MODEL_WINDOW_TIMESTEP {window_timestep}  /* s, between two samples of a window */

/* z (n): the state from the {samples} newest outputs (delays + 1, p), oldest first, and the inputs held between them
   (delays, m). */
void model_encode(const double *window, const double *inputs, double *z);

/* y (p): the outputs of state z (n). */
void model_decode(const double *z, double *y);

/* y (p), and C (p, n) = dy/dz. */
void model_decode_jacobian(const double *z, double *y, double *C);

/* next (n): the state one timestep after z (n), with input u (m) held. */
void model_step(const double *z, const double *u, double *next);

/* next (n), A (n, n) = dnext/dz and B (n, m) = dnext/du. */
void model_step_jacobians(const double *z, const double *u, double *next, double *A, double *B);

/* From z (n) under inputs (steps, m): states (steps + 1, n), the first of which is z, and along them
   A (steps, n, n), B (steps, n, m), outputs (steps + 1, p), C (steps + 1, p, n). */
void model_horizon(int steps, const double *z, const double *inputs, double *states, double *A, double *B,
                   double *outputs, double *C);

#ifdef __cplusplus
}}
#endif

#endif
"""

ENTRIES = """\
void model_encode(const double *window, const double *inputs, double *z)
{
    encode_window(window, inputs, z);
}

void model_decode(const double *z, double *y)
{
    decode_state(z, y, NULL);
}

void model_decode_jacobian(const double *z, double *y, double *C)
{
    decode_state(z, y, C);
}

void model_horizon(int steps, const double *z, const double *inputs, double *states, double *A, double *B,
                   double *outputs, double *C)
{
    int i, k;
    for (i = 0; i < N; i++)
        states[i] = z[i];
    decode_state(states, outputs, C);
    for (k = 0; k < steps; k++) {
        model_step_jacobians(states + k * N, inputs + k * M, states + (k + 1) * N, A + k * N * N, B + k * N * M);
        decode_state(states + (k + 1) * N, outputs + (k + 1) * P, C + (k + 1) * P * N);
    }
}
"""


class CSource(NamedTuple):
    """A C file and its header, named NAME.c and NAME.h; all its functions begin with NAME_."""

    name: str
    source: str
    header: str


def write_c(model: Model, card: dict) -> CSource:
    """The C file of a model. The header's comment repeats what the artifact's card says.

    Functions NAME_encode, _decode, _decode_jacobian, _step, _step_jacobians, _horizon; see the header. Raises
    ValueError for a kind of model that has no C form.
    """
    family, name = _family(model), identifier(card["name"])
    sizes = {"N": model.state_dim, "M": model.input_dim, "P": model.output_dim, "D": model.delays} | family.sizes
    includes = ["<stddef.h>"] + ["<math.h>"] * family.mathematics
    source = (f"/* {comment(card['name'])}; see {name}.h. Written by ssmr_torch; do not edit. */\n"
              f"#include \"{name}.h\"\n\n" + "".join(f"#include {file}\n" for file in includes)
              + "\nenum { " + ", ".join(f"{size} = {value}" for size, value in sizes.items()) + " };\n\n"
              + family.code + ENTRIES)
    return CSource(name, _named(source, name), _named(_header(model, card, family.scratch), name))


def _family(model: Model) -> Family:
    """The model's part of the file, by the writer that its class names as "module:function"."""
    if model.c_source is None:
        raise ValueError(f"a {type(model).__name__} cannot be written in C, because its class names no writer. Leave c "
                         "out of the formats, or set its c_source to \"module:function\", where the function makes a "
                         "ssmr_torch.deployment.c.c_text.Family of the model")
    return found(model.c_source)(model)


def _header(model: Model, card: dict, scratch: int) -> str:
    units, (low, high) = card["units"], card["input_range"]
    lines = [model.geometry, f"artifact: tables with sha256 {card['sha256']['tables.safetensors']}",
             f"outputs, m from rest: {', '.join(card['output_names'])}; rest: {', '.join(map(repr, card['rest']))}",
             f"inputs, {units['input']}: " + ", ".join(f"{input} {a:g} to {b:g}" for input, a, b in
                                                       zip(card["input_names"], low, high))]
    return HEADER.format(title=comment(f"{card['name']}: {card['kind']} model, written by ssmr_torch"),
                         lines="\n   ".join(map(comment, lines)), stack=f"{8 * scratch / 1024 + 0.5:.1f} kB",
                         n=model.state_dim, m=model.input_dim, p=model.output_dim, delays=model.delays,
                         samples=model.delays + 1, timestep=repr(model.timestep),
                         window_timestep=repr(model.window_timestep))


def _named(text: str, name: str) -> str:
    """Replace `model_` and `MODEL_` at the beginning of words by the model's own prefix."""
    text = re.sub(r"\bmodel_(?=encode|decode|step|horizon)", f"{name}_", text)
    return re.sub(r"\bMODEL_", f"{name.upper()}_", text)
