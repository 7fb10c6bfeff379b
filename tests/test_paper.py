"""What the paper says, checked: its closed form with the erratum, and its inert contrast."""

import numpy as np
import pytest

import tisfm
from bench import reference
from tests.rendered import two_blocks


def equation_18(s, it, b, neighbours, alpha, third):
    """Eq. 18 for one pixel as the paper prints it, but for the factor of q in its third line.

    That is `third`: s3, or s1 as printed. `b` are the sums of weights and `neighbours` the sums of
    b_N τ_N (eq. 17). The first term of q's denominator carries α.
    """
    b1, b2, b3 = b
    n1, n2, n3 = neighbours
    s1, s2, s3 = s
    numerator = s1 * b2 * b3 * n1 + s2 * b1 * b3 * n2 + s3 * b1 * b2 * n3 + b1 * b2 * b3 * it
    q = numerator / (alpha * b1 * b2 * b3 + s1**2 * b2 * b3 + s2**2 * b1 * b3 + s3**2 * b1 * b2)
    return np.array([(n1 - s1 * q) / b1, (n2 - s2 * q) / b2, (n3 - third * q) / b3])


def test_equation_18_needs_s3_in_its_third_line():
    """The rest is right as printed: it solves eq. 16."""
    rng = np.random.default_rng(0)
    s, b = rng.normal(scale=5, size=3), rng.uniform(0.5, 4, size=3)
    neighbours, it, alpha = rng.normal(size=3), 1.7, 20.0
    matrix = alpha * np.diag(b) + np.outer(s, s)  # eq. 16
    solution = np.linalg.solve(matrix, alpha * neighbours - s * it)
    np.testing.assert_allclose(equation_18(s, it, b, neighbours, alpha, s[2]), solution)
    printed = equation_18(s, it, b, neighbours, alpha, s[0])
    assert abs(printed[2] - solution[2]) > 0.01 * np.abs(solution).max()


def test_equation_9_minimises_with_a_plus():
    """b = Φ'(a)/2a minimises b·a² + ψ(b), with ψ(b) = b + 1/b − 2 for Φ(a) = 2√(1 + a²) − 2."""
    for a in (0.1, 1.0, 7.0):
        b = np.linspace(1e-3, 1, 200_001)
        best = b[np.argmin(b * a**2 + b + 1 / b - 2)]
        assert best == pytest.approx(1 / np.sqrt(1 + a**2), abs=1e-5)
        attained = best * a**2 + best + 1 / best - 2
        assert attained == pytest.approx(float(reference.aubert(np.array(a), 1.0)), rel=1e-6)


def test_a_two_pixel_jump_leaves_the_papers_weight_at_one():
    """δ = 1 in the units of τ is f pixels: b = 1/√(1 + (2/600)²) = 0.999994."""

    def b(rho, contrast):
        return reference.edge_weights(rho, reference.Smoothness(contrast=contrast))[0, 0, 0]

    jump = np.zeros((1, 1, 2))
    jump[..., 1] = 2.0
    paper = tisfm.Settings.preset("paper").contrast_for(600.0)
    assert b(jump, paper) == pytest.approx(0.999994, abs=1e-6)
    default = tisfm.Settings().contrast_for(600.0)
    assert b(jump, default) < 0.02


def test_the_papers_contrast_blurs_edges_that_a_small_one_keeps():
    """Everything else equal, errors near motion boundaries."""
    pair = two_blocks(240, 320, seed=3)
    edges = np.zeros(pair.labels.shape, bool)
    edges[:, 1:] |= np.diff(pair.labels, axis=1) != 0
    edges[1:] |= np.diff(pair.labels, axis=0) != 0
    for _ in range(3):  # within three pixels of a boundary
        grown = edges.copy()
        grown[1:] |= edges[:-1]
        grown[:-1] |= edges[1:]
        grown[:, 1:] |= edges[:, :-1]
        grown[:, :-1] |= edges[:, 1:]
        edges = grown
    near = edges & pair.visible
    errors = {}
    for contrast in (None, tisfm.Settings().contrast):
        settings = tisfm.Settings(contrast=contrast)
        result = tisfm.interpret(pair.frame0, pair.frame1, camera=pair.camera, settings=settings)
        errors[contrast] = np.linalg.norm(result.flow - pair.flow, axis=-1)[near].mean()
        quadratic = tisfm.Settings(contrast=1e3 * pair.camera.focal)
        if contrast is None:  # not merely mild: the same as no edge preservation at all
            plain = tisfm.interpret(
                pair.frame0, pair.frame1, camera=pair.camera, settings=quadratic
            )
            assert np.abs(plain.flow - result.flow).max() < 0.01
    assert errors[tisfm.Settings().contrast] < 0.75 * errors[None]
