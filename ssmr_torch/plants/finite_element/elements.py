"""Element laws of the linear tetrahedron: corotational with edge frames, and compressible neo-Hookean.

With the gradients g_a of the shape functions and F = Σ x_a ⊗ g_a, both laws have, per unit of volume,

    force of node a    f_a = P g_a
    stiffness of a, b  K_ab = c₁ (g_a·g_b) I + c₂ ĝ_b ⊗ ĝ_a + c₃ ĝ_a ⊗ ĝ_b

so one kernel assembles both.
"""

from __future__ import annotations

import numpy as np

from ssmr_torch.plants.finite_element.compiled import kernel

COROTATIONAL, NEO_HOOKEAN = 0, 1
LAWS = {"corotational": COROTATIONAL, "neo_hookean": NEO_HOOKEAN}


def lame_parameters(young: float, poisson: float) -> tuple[float, float]:
    """λ = E ν / ((1 + ν)(1 − 2ν)) and μ = E / (2 (1 + ν)), Pa. Raises ValueError unless E > 0 and −1 < ν < ½."""
    if not (0 < young < np.inf and -1 < poisson < 0.5):
        raise ValueError(f"Young's modulus is {young} Pa and Poisson's ratio {poisson}; expected a positive modulus "
                         "and −1 < ν < 0.5")
    return young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson))


@kernel
def edge_frame(positions, nodes, frame):
    """Three columns: unit vector of edge 0 → 1, its normal in the face 0, 1, 2, and the normal of this face."""
    for i in range(3):
        frame[i, 0] = positions[nodes[1], i] - positions[nodes[0], i]
        frame[i, 1] = positions[nodes[2], i] - positions[nodes[0], i]
    _cross(frame, 0, 1, 2)
    _normalize(frame, 0)
    _normalize(frame, 2)
    _cross(frame, 2, 0, 1)
    _normalize(frame, 1)


@kernel
def _cross(frame, a, b, target):
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        frame[i, target] = frame[j, a] * frame[k, b] - frame[k, a] * frame[j, b]


@kernel
def _normalize(frame, column):
    length = np.sqrt(frame[0, column] ** 2 + frame[1, column] ** 2 + frame[2, column] ** 2)
    for i in range(3):
        frame[i, column] /= length


@kernel
def _gradient(positions, nodes, gradients, deformation):
    for i in range(3):
        for j in range(3):
            total = 0.0
            for a in range(4):
                total += positions[nodes[a], i] * gradients[a, j]
            deformation[i, j] = total


@kernel
def _corotational(deformation, rotation, lame, shear, stress):
    """P = R σ, σ = λ tr(ε) I + 2 μ ε, ε = sym(Rᵀ F) − I: linear elasticity in the rotated frame."""
    strain = np.empty((3, 3))
    for i in range(3):
        for j in range(i, 3):
            total = 0.0
            for k in range(3):
                total += rotation[k, i] * deformation[k, j] + rotation[k, j] * deformation[k, i]
            strain[i, j] = strain[j, i] = 0.5 * total
        strain[i, i] -= 1.0
    volumetric = lame * (strain[0, 0] + strain[1, 1] + strain[2, 2])
    for i in range(3):
        for j in range(3):
            total = volumetric * rotation[i, j]
            for k in range(3):
                total += 2 * shear * rotation[i, k] * strain[k, j]
            stress[i, j] = total


@kernel
def _inverse_transpose(matrix, result):
    """result = matrix⁻ᵀ; returns the determinant."""
    for i in range(3):
        for j in range(3):
            a, b, c, d = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            result[i, j] = matrix[a, c] * matrix[b, d] - matrix[a, d] * matrix[b, c]
    determinant = 0.0
    for j in range(3):
        determinant += matrix[0, j] * result[0, j]
    for i in range(3):
        for j in range(3):
            result[i, j] /= determinant
    return determinant


@kernel
def assemble(law, positions, tetrahedra, gradients, volumes, rest_frames, lame, shear, force, places, strides, data):
    """Add internal forces to `force` (N, 3) and stiffness to `data`; returns the number of inverted elements.

    places: (E, 4, 4), where the block of nodes a, b starts in `data`, −1 for clamped nodes. strides: (E, 4), from one
    column of the blocks of node b to the next. With an empty `data` no stiffness is computed.
    law COROTATIONAL: rotation R from the edge frames now and at rest; tangent with R fixed, R K_e Rᵀ.
    law NEO_HOOKEAN: Ψ = μ/2 (tr FᵀF − 3) − μ ln J + λ/2 (ln J)²; exact tangent; ln J of an inverted element is NaN.
    """
    deformation, turned, stress = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    frame, moved = np.empty((3, 3)), np.empty((4, 3))
    inverted = 0
    for e in range(len(tetrahedra)):
        nodes, gradient, volume = tetrahedra[e], gradients[e], volumes[e]
        _gradient(positions, nodes, gradient, deformation)
        mixed = shear
        if law == COROTATIONAL:
            edge_frame(positions, nodes, frame)
            for i in range(3):
                for j in range(3):
                    turned[i, j] = (frame[i, 0] * rest_frames[e, j, 0] + frame[i, 1] * rest_frames[e, j, 1]
                                    + frame[i, 2] * rest_frames[e, j, 2])
            _corotational(deformation, turned, lame, shear, stress)
        else:
            determinant = _inverse_transpose(deformation, turned)
            inverted += determinant <= 0
            logarithm = np.log(determinant) if determinant > 0 else np.nan
            mixed = shear - lame * logarithm
            for i in range(3):
                for j in range(3):
                    stress[i, j] = shear * deformation[i, j] - mixed * turned[i, j]
        for a in range(4):
            for i in range(3):
                force[nodes[a], i] += volume * (stress[i, 0] * gradient[a, 0] + stress[i, 1] * gradient[a, 1]
                                                + stress[i, 2] * gradient[a, 2])
                moved[a, i] = (turned[i, 0] * gradient[a, 0] + turned[i, 1] * gradient[a, 1]
                               + turned[i, 2] * gradient[a, 2])
        if len(data):
            _add_stiffness(gradient, moved, volume * shear, volume * mixed, volume * lame, places[e], strides[e], data)
    return inverted


@kernel
def _add_stiffness(gradient, moved, diagonal, crossed, direct, places, strides, data):
    """Add the blocks a ≥ b, and the blocks a > b once more, transposed."""
    for b in range(4):
        for a in range(b, 4):
            place, mirrored = places[a, b], places[b, a]
            if place < 0:
                continue
            down, right = strides[b], strides[a]
            isotropic = diagonal * (gradient[a, 0] * gradient[b, 0] + gradient[a, 1] * gradient[b, 1]
                                    + gradient[a, 2] * gradient[b, 2])
            for j in range(3):
                first, second = crossed * moved[a, j], direct * moved[b, j]
                for i in range(3):
                    value = first * moved[b, i] + second * moved[a, i]
                    if i == j:
                        value += isotropic
                    data[place + j * down + i] += value
                    if a > b:
                        data[mirrored + i * right + j] += value


@kernel
def _frame_spin(positions, nodes, frame, spin):
    """∂ω/∂x for the nodes 0, 1, 2, (3, 3, 3): moving these nodes rotates the frame by ω. Node 3 does not rotate it.

    With e₁, e₂, e₃ the frame, ℓ the edge 0 → 1 and a = x₂ − x₀: ω = e₁ × δx₀₁ / ℓ + w e₁,
    w = e₃·(δx₀₂ − (a·e₁ / ℓ) δx₀₁) / (a·e₂).
    """
    length = along = height = 0.0
    for i in range(3):
        length += (positions[nodes[1], i] - positions[nodes[0], i]) * frame[i, 0]
        along += (positions[nodes[2], i] - positions[nodes[0], i]) * frame[i, 0]
        height += (positions[nodes[2], i] - positions[nodes[0], i]) * frame[i, 1]
    for i in range(3):
        for j in range(3):
            twist = frame[i, 0] * frame[j, 2] / height
            # e₁ × (unit vector j) has only components different from j.
            tilt = 0.0
            if i == (j + 1) % 3:
                tilt = frame[(j + 2) % 3, 0] / length
            elif i == (j + 2) % 3:
                tilt = -frame[(j + 1) % 3, 0] / length
            spin[2, i, j] = twist
            spin[1, i, j] = tilt - along / length * twist
            spin[0, i, j] = -spin[1, i, j] - twist


@kernel
def add_frame_stiffness(positions, tetrahedra, gradients, volumes, rest_frames, lame, shear, places, strides, data):
    """Add the effect of the frames' rotation to R K_e Rᵀ. This makes the corotational tangent exact and unsymmetric.

    δf_a = V (ω × P g_a − R C:sym(Rᵀ [ω] F) g_a), ω = Σ_b (∂ω/∂x_b) δx_b.
    """
    deformation, rotation, stress = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    frame, spin, turned, change = np.empty((3, 3)), np.empty((3, 3, 3)), np.empty((4, 3, 3)), np.empty((3, 3))
    for e in range(len(tetrahedra)):
        nodes, gradient, volume = tetrahedra[e], gradients[e], volumes[e]
        _gradient(positions, nodes, gradient, deformation)
        edge_frame(positions, nodes, frame)
        _product(frame, rest_frames[e].T, rotation)
        _corotational(deformation, rotation, lame, shear, stress)
        _frame_spin(positions, nodes, frame, spin)
        for k in range(3):
            _turning(deformation, rotation, stress, k, lame, shear, change)
            for a in range(4):
                for i in range(3):
                    turned[a, i, k] = volume * (change[i, 0] * gradient[a, 0] + change[i, 1] * gradient[a, 1]
                                                + change[i, 2] * gradient[a, 2])
        for a in range(4):
            for b in range(3):
                if places[e, a, b] >= 0:
                    _product(turned[a], spin[b], change)
                    for j in range(3):
                        for i in range(3):
                            data[places[e, a, b] + j * strides[e, b] + i] += change[i, j]


@kernel
def _product(left, right, product):
    for i in range(3):
        for j in range(3):
            product[i, j] = left[i, 0] * right[0, j] + left[i, 1] * right[1, j] + left[i, 2] * right[2, j]


@kernel
def _turning(deformation, rotation, stress, k, lame, shear, change):
    """∂P = [e_k] P − R C:sym(Rᵀ [e_k] F), for a rotation of the frame about axis k."""
    after, last = (k + 1) % 3, (k + 2) % 3
    strain = np.empty((3, 3))
    for i in range(3):
        for j in range(i, 3):
            strain[i, j] = strain[j, i] = 0.5 * (
                rotation[after, i] * deformation[last, j] - rotation[last, i] * deformation[after, j]
                + rotation[after, j] * deformation[last, i] - rotation[last, j] * deformation[after, i])
    volumetric = lame * (strain[0, 0] + strain[1, 1] + strain[2, 2])
    for i in range(3):
        for j in range(3):
            change[i, j] = volumetric * rotation[i, j] + 2 * shear * (
                rotation[i, 0] * strain[0, j] + rotation[i, 1] * strain[1, j] + rotation[i, 2] * strain[2, j])
    for j in range(3):
        change[last, j] += stress[after, j]
        change[after, j] -= stress[last, j]


@kernel
def rest_frames(positions, tetrahedra):
    """(E, 3, 3) edge frames of the undeformed tetrahedra."""
    frames = np.empty((len(tetrahedra), 3, 3))
    for e in range(len(tetrahedra)):
        edge_frame(positions, tetrahedra[e], frames[e])
    return frames
