"""Registration of subsets against exact truth, the Cramer-Rao bound and an independent program."""

import warnings

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from moving_frames import NOISE, NaturalTexture, digitize, grid_points
from textures import WaveTexture
from vfm_sdm.errors import DatasetError, SessionError
from vfm_sdm.stages.registration.subsets import Starts, SubsetBank, register_subset

SIZE = 256
POINTS = grid_points(SIZE, 33, 45)


@pytest.fixture(scope="module")
def texture():
    return NaturalTexture(1, contrast=28)


@pytest.fixture(scope="module")
def reference(texture):
    return digitize(texture.image())


def std_of(registration):
    return np.sqrt(np.einsum("pkk->pk", registration.covariance))


@pytest.mark.parametrize(("cutoff", "bias_px"), [(0.2, 1e-4), (0.3, 6e-4), (0.4, 0.0025), (0.5, 0.005)])
def test_bias_in_steps_of_a_twentieth_pixel(cutoff, bias_px):
    """Noise-free, 16 bits: what is left is the interpolation. Below 0.005 px even for textures that reach half the
    sampling frequency (without the low-pass of the gradients: 0.011 px), far below for those that a lens leaves."""
    texture = NaturalTexture(2, cutoff=cutoff, contrast=28)
    reference = digitize(texture.image(), dtype=np.uint16, scale=200)
    bank = SubsetBank.prepare(reference, POINTS)
    for shift in np.arange(0, 1.01, 0.05):
        current = digitize(texture.image((shift, -shift)), dtype=np.uint16, scale=200)
        error = bank.register(current, POINTS + [shift, -shift] + 0.2).position - POINTS - [shift, -shift]
        assert np.abs(error.mean(axis=0)).max() <= bias_px, f"shift {shift}"


@pytest.mark.parametrize(("cutoff", "exponent", "contrast"), [(0.3, 1.0, 45.0), (0.2, 1.5, 40.0), (0.3, 1.0, 15.0)])
def test_reaches_the_cramer_rao_bound_and_states_it(cutoff, exponent, contrast):
    """Noise of 1 % of the grey range in both frames, shifts in steps of 0.05 px."""
    rng = np.random.default_rng(3)
    texture = NaturalTexture(4, size=512, cutoff=cutoff, exponent=exponent, contrast=contrast)
    points = grid_points(512, 42, 46)
    errors, variances = [], []
    for shift in np.arange(0, 0.51, 0.05):
        reference = digitize(texture.image(), rng, NOISE)
        current = digitize(texture.image((shift, -shift)), rng, NOISE)
        registration = register_subset(reference, current, points, Starts(points))
        assert registration.converged.all()
        errors.append(registration.position - points - [shift, -shift])
        variances.append(np.einsum("pkk->pk", registration.covariance))
    errors, bound = np.array(errors), texture.cramer_rao_std(points, 41, NOISE)
    rms = np.sqrt((errors**2).mean())
    assert rms <= 1.3 * np.sqrt((bound**2).mean())
    assert np.abs(errors.mean(axis=1)).max() <= max(0.005, 3 * rms / np.sqrt(len(points) / 2))
    # The stated standard deviation is the real one: as a whole, and point by point in units of itself.
    assert np.sqrt(np.mean(variances)) == pytest.approx(rms, rel=0.15)
    assert np.sqrt(np.mean(errors**2 / np.array(variances))) == pytest.approx(1, rel=0.15)


def test_stated_deviation_does_not_depend_on_the_fraction_of_a_pixel(texture):
    """Half-way between pixels interpolation hides a third of a frame's noise from the residual; it is still there."""
    rng = np.random.default_rng(9)
    reference = digitize(texture.image(), rng, NOISE)
    stated = [
        std_of(register_subset(reference, digitize(texture.image((s, s)), rng, NOISE), POINTS, Starts(POINTS))).mean()
        for s in (0.0, 0.25, 0.5)
    ]
    np.testing.assert_allclose(stated, stated[0], rtol=0.03)


def test_stated_correlation_of_errors_is_real():
    """An oblique texture: errors of u and v go together, and the covariance says so."""
    rng = np.random.default_rng(5)
    texture = NaturalTexture(6, size=512, cutoff=0.2)
    texture.spectrum = texture.spectrum * np.exp(-(((texture.fu - texture.fv) / 0.05) ** 2))
    texture.spectrum *= 45 / np.fft.ifft2(texture.spectrum).real.std()
    points = grid_points(512, 42, 46)
    reference, current = digitize(texture.image(), rng, NOISE), digitize(texture.image((0.3, 0.1)), rng, NOISE)
    registration = register_subset(reference, current, points, Starts(points))
    error = registration.position - points - [0.3, 0.1]
    whitened = np.linalg.solve(np.linalg.cholesky(registration.covariance), error[..., None])[..., 0]
    stated = registration.covariance[:, 0, 1] / np.prod(std_of(registration), axis=1)
    assert np.median(stated) < -0.5
    assert np.corrcoef(error.T)[0, 1] == pytest.approx(np.median(stated), abs=0.15)
    np.testing.assert_allclose(np.cov(whitened.T), np.eye(2), atol=0.35)


def test_gain_and_bias_change_nothing(texture, reference):
    """ZNSSD: the same frame, half as bright and lifted, or with other offsets in 16 bits."""
    moved = texture.image((0.37, -0.21))
    plain = register_subset(reference, digitize(moved, dtype=np.uint16, scale=100), POINTS, Starts(POINTS))
    dimmed = register_subset(reference, digitize(0.4 * moved + 90, dtype=np.uint16, scale=100), POINTS, Starts(POINTS))
    lifted = register_subset(reference, digitize(moved + 400, dtype=np.uint16, scale=100), POINTS, Starts(POINTS))
    np.testing.assert_allclose(dimmed.position, plain.position, atol=1e-4)
    np.testing.assert_allclose(lifted.position, plain.position, atol=1e-4)
    assert plain.position - POINTS == pytest.approx(np.tile([0.37, -0.21], (len(POINTS), 1)), abs=0.004)


def test_faint_texture_in_bright_light_keeps_its_figures(texture):
    """Single precision has 24 bits: a contrast of 28 on a background of 60000 must not drown in rounding."""
    rng = np.random.default_rng(13)
    images = [texture.image(shift) + rng.normal(0, NOISE, (SIZE, SIZE)) for shift in ((0.0, 0.0), (0.37, -0.21))]
    dark, bright = (
        register_subset(*(digitize(image + level, dtype=np.uint16) for image in images), POINTS, Starts(POINTS))
        for level in (100, 60000)
    )
    np.testing.assert_allclose(bright.position, dark.position, atol=1e-4)
    np.testing.assert_allclose(std_of(bright), std_of(dark), rtol=1e-3)


def test_inverted_contrast_is_not_a_match(reference):
    registration = register_subset(reference, 255 - reference, POINTS, Starts(POINTS))
    assert not registration.converged.any()
    assert np.isnan(registration.position).all()


def affine_pair(texture_seed, affine, shift, size=320):
    """A reference and the same analytic waves under x -> A (x - c) + c + shift about the image's centre c."""
    rng = np.random.default_rng(texture_seed)
    length = np.exp(rng.uniform(np.log(6), np.log(60), 120))
    angle = rng.uniform(0, 2 * np.pi, 120)
    k = 2 * np.pi / length[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    phase = rng.uniform(0, 2 * np.pi, 120)
    amplitude = 40 * np.sqrt(length) / np.sqrt(length.sum() / 2)
    v, u = np.mgrid[:size, :size].astype(float)
    places = np.stack([u, v], axis=-1)
    center = np.array([size / 2, size / 2])

    def gray(at):
        return digitize(127 + np.cos(at @ k.T + phase) @ amplitude, dtype=np.uint16, scale=100)

    return gray(places), gray((places - center - shift) @ np.linalg.inv(affine).T + center), center


AFFINE = np.array([[0.88, 0.03], [-0.05, 1.04]])  # about what 30 degrees of convergence do to a facade


def test_affine_deformation_is_found_with_its_position():
    """The sub-pixel offset of the named point goes through the warp."""
    shift = np.array([0.4, -0.3])
    reference, current, center = affine_pair(7, AFFINE, shift)
    points = center + np.array([[0.0, 0.0], [25.4, -31.7], [-40.45, 12.3], [33.5, 28.5]])
    truth = (points - center) @ AFFINE.T + center + shift
    start = np.tile(np.eye(2) + 0.6 * (AFFINE - np.eye(2)), (4, 1, 1))
    registration = register_subset(reference, current, points, Starts(truth + 0.8, start))
    np.testing.assert_allclose(registration.position, truth, atol=0.002)
    np.testing.assert_allclose(registration.affine, np.tile(AFFINE, (4, 1, 1)), atol=2e-4)
    assert (registration.correlation > 0.9999).all()


def test_agrees_with_an_independent_program():
    """OpenCV's ECC, another affine criterion that ignores gain and bias, on the same subset."""
    reference, current, center = affine_pair(8, AFFINE, np.zeros(2))
    point = center + np.array([20.0, -12.0])
    left, top, half = int(point[0]) - 20, int(point[1]) - 20, 20
    template = (reference[top : top + 41, left : left + 41] / 256).astype(np.float32)
    warp = np.column_stack([AFFINE, center - AFFINE @ center + AFFINE @ [left, top]]).astype(np.float32)
    warp[:, 2] += 0.4
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-9)
    _, warp = cv2.findTransformECC(
        template, (current / 256).astype(np.float32), warp, cv2.MOTION_AFFINE, criteria, None, 1
    )
    other = warp @ [half, half, 1]
    registration = register_subset(reference, current, [point], Starts([other + 0.5], AFFINE[None]))
    np.testing.assert_allclose(registration.position[0], other, atol=0.02)
    np.testing.assert_allclose(registration.affine[0], warp[:, :2], atol=0.003)


def test_small_and_large_deformations_join_without_a_step():
    """The switch between the two ways of sampling (at 0.15 px over the subset) leaves no trace."""
    for stretch in (0.006, 0.007, 0.0074, 0.0076, 0.008, 0.009):
        affine = np.eye(2) + np.array([[stretch, 0.0], [0.0, 0.0]])
        reference, current, center = affine_pair(9, affine, np.array([0.2, 0.3]), size=120)
        registration = register_subset(reference, current, [center], Starts([center]))
        np.testing.assert_allclose(registration.position[0], center + np.array([0.2, 0.3]), atol=1e-3)
        np.testing.assert_allclose(registration.affine[0], affine, atol=5e-4)
        assert registration.correlation[0] > 0.9999  # the deformation is no residual, sampled or linearised


def test_named_points_between_the_pixels(texture, reference):
    """The offset to the nearest pixel is carried, not rounded: neighbours of one pixel move alike."""
    offsets = np.array([[0.0, 0.0], [0.49, 0.0], [-0.49, 0.31], [0.25, -0.5]])
    points = np.array([128.0, 120.0]) + offsets
    registration = register_subset(reference, digitize(texture.image((2.3, 1.6))), points, Starts(points + 2))
    np.testing.assert_allclose(registration.position - points, np.tile([2.3, 1.6], (4, 1)), atol=0.005)


@pytest.mark.parametrize("subset_px", [9, 21, 41, 61])
def test_subset_sizes(texture, reference, subset_px):
    current = digitize(texture.image((0.4, 0.3)))
    registration = register_subset(reference, current, POINTS, Starts(POINTS), subset_px=subset_px)
    error = registration.position - POINTS - [0.4, 0.3]
    assert registration.converged.mean() > 0.95
    assert np.sqrt(np.nanmean(error**2)) < 0.15 / subset_px


def test_layouts_of_memory_give_one_result(texture, reference):
    """Padded lines of a decoder, read-only buffers, rotated views, Fortran order."""
    current = digitize(texture.image((0.4, -0.3)))
    padded, inset = (np.full((SIZE + 9, SIZE + 64), 255, np.uint8) for _ in range(2))
    padded[:SIZE, :SIZE] = inset[9:, 32 : SIZE + 32] = current
    padded.flags.writeable = False
    rotated = np.rot90(np.ascontiguousarray(np.rot90(current)), -1)
    expected = register_subset(reference, current, POINTS, Starts(POINTS)).position
    parts = (padded[:SIZE, :SIZE], padded[:, :SIZE][:SIZE], inset[9:, 32 : SIZE + 32])
    for image in (*parts, rotated, np.asfortranarray(current)):
        assert not image.flags.c_contiguous
        np.testing.assert_array_equal(register_subset(reference, image, POINTS, Starts(POINTS)).position, expected)


def test_points_do_not_influence_each_other(texture, reference):
    """Alone, together, in another order, with others that fail, in several threads."""
    points = np.concatenate([POINTS, [[3.0, 3.0]], POINTS[:5] + 0.5])
    current = digitize(texture.image((0.4, -0.3)))
    together = register_subset(reference, current, points, Starts(points))
    backwards = register_subset(reference, current, points[::-1], Starts(points[::-1]))
    np.testing.assert_allclose(together.position, backwards.position[::-1], rtol=0, atol=1e-9)
    for k in (0, 7, len(POINTS), len(POINTS) + 3):
        alone = register_subset(reference, current, points[k : k + 1], Starts(points[k : k + 1]))
        np.testing.assert_allclose(alone.position[0], together.position[k], rtol=0, atol=1e-9)
        np.testing.assert_allclose(alone.covariance[0], together.covariance[k], rtol=1e-9)


def test_many_starts_for_one_point(texture, reference):
    current = digitize(texture.image((0.4, -0.3)))
    starts = POINTS[0] + np.array([[0.0, 0.0], [1.0, 1.0], [np.nan, 0.0], [70.0, 60.0]])
    registration = register_subset(reference, current, np.tile(POINTS[0], (4, 1)), Starts(starts))
    np.testing.assert_allclose(registration.position[:2], np.tile(POINTS[0] + [0.4, -0.3], (2, 1)), atol=0.005)
    assert np.isnan(registration.position[2:]).all()
    assert not registration.outside.any()


def test_a_subset_across_the_border_is_outside(texture, reference):
    """In the reference: not usable. In the current image: outside. Both NaN, both named."""
    current = digitize(texture.image())
    points = np.array([[20.0, 100.0], [19.0, 100.0], [SIZE - 20.4, 100.0], [120.0, 120.0]])
    bank = SubsetBank.prepare(reference, points)
    np.testing.assert_array_equal(bank.inside, [True, False, False, True])
    np.testing.assert_array_equal(bank.usable, bank.inside)
    starts = np.array([[20.0, 100.0], [60.0, 60.0], [60.0, 60.0], [SIZE - 5.0, 120.0]])
    registration = bank.register(current, starts)
    np.testing.assert_array_equal(registration.converged, [True, False, False, False])
    np.testing.assert_array_equal(registration.outside, [False, False, False, True])
    assert np.isnan(registration.position[1:]).all()
    np.testing.assert_allclose(registration.position[0], points[0], atol=1e-5)


def test_a_subset_that_touches_the_border_is_as_good_as_any(texture):
    """The spline's coefficients need pixels beyond the border, which do not exist: mirrored ones stand in."""
    u, v = np.meshgrid([20.6, 128.0, SIZE - 21.6], [20.6, 128.0, SIZE - 21.6])
    points = np.column_stack([u.ravel(), v.ravel()])
    reference = digitize(texture.image((0.4, 0.3)), dtype=np.uint16, scale=200)
    current = digitize(texture.image(), dtype=np.uint16, scale=200)
    registration = register_subset(reference, current, points + 0.4, Starts(points))
    np.testing.assert_allclose(registration.position, points + np.array([0.0, 0.1]), atol=0.004)


def test_images_of_other_size(reference):
    """Two views need not have one size; nor be larger than a subset."""
    cut = np.ascontiguousarray(reference[30:200, 20:230])
    registration = register_subset(reference, cut, [[120.0, 110.0]], Starts([[100.3, 80.2]]))
    np.testing.assert_allclose(registration.position, [[100.0, 80.0]], atol=1e-4)
    tiny = register_subset(reference, reference[:30, :30].copy(), [[120.0, 110.0]], Starts([[15.0, 15.0]]))
    assert tiny.outside.all()


@pytest.mark.parametrize("kind", ["flat", "edge", "saturated"])
def test_texture_that_does_not_fix_the_warp_is_not_usable(kind):
    image = np.full((100, 100), 255 if kind == "saturated" else 100, np.uint8)
    if kind == "edge":
        image[:, 50:] = 200
    bank = SubsetBank.prepare(image, [[50.0, 50.0]])
    assert not bank.usable.any()
    assert bank.inside.all()
    registration = bank.register(image, [[50.0, 50.0]])
    assert np.isnan(registration.position).all()
    assert not registration.converged.any()


def test_gradients_of_mere_noise_get_no_covariance():
    """The same noise twice matches itself; against another noise nothing is claimed."""
    rng = np.random.default_rng(11)
    noise = [digitize(np.full((120, 120), 127.0), rng, 8.0) for _ in range(2)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        registration = register_subset(noise[0], noise[1], [[60.0, 60.0]], Starts([[60.0, 60.0]]))
    assert not np.isfinite(registration.covariance).any()


def test_reference_against_itself_is_exact(texture, reference):
    """As exact as the residual: three sums in single precision, of 41 x 41 products each in four lanes or more."""
    registration = register_subset(reference, reference, POINTS + 0.3, Starts(POINTS + 0.3))
    np.testing.assert_allclose(registration.position, POINTS + 0.3, rtol=0, atol=1e-5)
    # Each addition rounds by half an eps of what has been summed up so far, on average half of the sum.
    share = 3 * (41**2 / 4) * np.finfo(np.float32).eps / 4
    np.testing.assert_allclose(registration.correlation, 1, rtol=0, atol=share / 2)
    # The stated deviation grows with the square root of the share that the template does not explain.
    noisy = register_subset(
        reference, digitize(texture.image(), np.random.default_rng(3), NOISE), POINTS, Starts(POINTS)
    )
    scale = np.sqrt(share / (1 - noisy.correlation**2))
    assert (std_of(registration) <= scale[:, None] * std_of(noisy)).all()
    assert scale.max() < 0.1


def test_failure_is_nan_everywhere(texture, reference):
    other = digitize(NaturalTexture(99).image())
    registration = register_subset(reference, other, POINTS, Starts(POINTS), max_iterations=3)
    assert np.isnan(registration.position[~registration.converged]).all()
    assert np.isnan(registration.affine[~registration.converged]).all()
    assert np.isnan(registration.covariance[~registration.converged]).all()
    assert (registration.iterations <= 3).all()
    assert (~registration.converged).mean() > 0.9


@settings(max_examples=25, deadline=None)
@given(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))
def test_any_shift_within_reach_is_found(u, v):
    texture = NaturalTexture(12, cutoff=0.25)
    points = np.array([[120.0, 130.0], [80.3, 60.6]])
    registration = register_subset(digitize(texture.image()), digitize(texture.image((u, v))), points, Starts(points))
    np.testing.assert_allclose(registration.position, points + np.array([u, v]), atol=0.01)


def test_misuse_is_refused(reference):
    with pytest.raises(DatasetError, match=r"reference: expected one plane .* got float64 of shape \(256, 256\)"):
        register_subset(reference.astype(float), reference, POINTS, Starts(POINTS))
    with pytest.raises(DatasetError, match=r"current: expected one plane .* got uint8 of shape \(256, 256, 3\)"):
        register_subset(reference, np.repeat(reference[:, :, None], 3, axis=2), POINTS, Starts(POINTS))
    with pytest.raises(DatasetError, match=r"current: expected one plane .* got list"):
        register_subset(reference, reference.tolist(), POINTS, Starts(POINTS))
    with pytest.raises(SessionError, match="subset_px: expected an odd number of at least 9 pixels, got 40"):
        register_subset(reference, reference, POINTS, Starts(POINTS), subset_px=40)
    with pytest.raises(SessionError, match="subset_px: expected an odd number of at least 9 pixels, got 7"):
        register_subset(reference, reference, POINTS, Starts(POINTS), subset_px=7)
    with pytest.raises(DatasetError, match="points: expected finite pixels"):
        SubsetBank.prepare(reference, [[np.nan, 3.0]])
    with pytest.raises(DatasetError, match=r"points_reference: expected shape \(any, 2\)"):
        register_subset(reference, reference, [1.0, 2.0, 3.0], Starts(POINTS))
    with pytest.raises(DatasetError, match="position: expected shape"):
        register_subset(reference, reference, POINTS, Starts(POINTS[:3]))
    with pytest.raises(DatasetError, match="affine: expected shape"):
        register_subset(reference, reference, POINTS, Starts(POINTS, np.eye(2)))


def test_dark_views_out_of_focus_converge_with_patience():
    # Noise in the gradients shortens every step: such subsets take more than twenty.
    v, u = np.mgrid[:160, :600].astype(float)

    def view(shift_px, seed):
        dim = 0.3 * gaussian_filter(WaveTexture(5)(u - shift_px, v), 2.0)
        return np.clip(np.rint(dim + np.random.default_rng(seed).normal(0, 2.0, dim.shape)), 0, 255).astype(np.uint8)

    points = np.array([[100.0 + 50 * k, 80.0] for k in range(9)])
    found = SubsetBank.prepare(view(0.0, 1), points, subset_px=61).register(view(0.4, 2), points)
    assert found.converged.all()
    assert found.iterations.max() > 20
    np.testing.assert_allclose(found.position - points, np.broadcast_to([0.4, 0.0], points.shape), atol=0.15)
