"""Extends the window of a model without changing its predictions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ssmr_torch.models.monomials import Monomials
from ssmr_torch.models.polynomial import PolynomialModel


def longer_window(model: PolynomialModel, delays: int) -> PolynomialModel:
    """The same model, with a linear chart over [1, a window of at least delays + 1 samples, all past inputs in it]. The
    coefficients of new entries are zero.
    """
    delays, latent, m = max(delays, model.delays), model.latent_dim, model.input_dim
    window, shift = (delays + 1) * latent, delays - model.delays
    order = tuple(range(window + delays * m))
    own = (model.delays + 1) * latent
    places = [place + shift * latent if place < own else window + shift * m + place - own
              for place in model.structure.window_order]
    scale = np.empty(len(order))
    scale[:window] = np.max(model.window_scale[:1])
    scale[window:] = np.tile(_input_scale(model, own), delays) if delays else 1.0
    chart = np.zeros((model.state_dim, 1 + len(order)))
    chart[:, 0] = model.chart[:, 0]
    chart[:, 1 + np.array(places)] = model.chart[:, 1:] * scale[places] / model.window_scale
    linear = Monomials(len(order), [(), *((k,) for k in range(len(order)))])
    return replace(model, structure=model.structure._replace(chart=linear, window_order=order), chart=chart,
                   window_scale=scale, delays=delays)


def _input_scale(model: PolynomialModel, window: int) -> np.ndarray:
    """Scale by which the chart divides each input, (m,); 1 if it uses no inputs."""
    found = np.ones(model.input_dim)
    for place, size in zip(model.structure.window_order, model.window_scale):
        if place >= window:
            found[(place - window) % model.input_dim] = size
    return found
