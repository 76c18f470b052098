"""Subsets by design: reduced warps, masks and several sizes, against exact truth and what they state of themselves."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.special import erf

from moving_frames import NOISE, NaturalTexture, digitize, grid_points
from vfm_sdm.core.datasets import UNMEASURED_STD_PX
from vfm_sdm.errors import DatasetError, SessionError
from vfm_sdm.stages.registration.subsets import SubsetBank, SubsetDesign, Warp

SIZE = 256
POINTS = grid_points(SIZE, 33, 45)
SHIFT = np.array([0.37, -0.21])
ACROSS = np.array([0.6, 0.8])


@pytest.fixture(scope="module")
def texture():
    return NaturalTexture(1, contrast=28)


@pytest.fixture(scope="module")
def reference(texture):
    return digitize(texture.image())


def edge_image(moved_px=0.0, *, contrast=60.0):
    """A blurred step whose direction across is `ACROSS`, through the middle of the picture."""
    u, v = np.meshgrid(np.arange(120.0), np.arange(120.0))
    distance = (u - 60) * ACROSS[0] + (v - 60) * ACROSS[1] - moved_px
    return 110 + contrast / 2 * erf(distance / 2.5)


def prepare(image, points, design):
    return SubsetBank.prepare(image, points, designs=[design] * len(points))


def test_the_default_design_is_the_square_with_an_affine_warp(texture, reference):
    rng = np.random.default_rng(7)
    noisy, current = (digitize(texture.image(shift), rng, NOISE) for shift in ((0, 0), SHIFT))
    plain = SubsetBank.prepare(noisy, POINTS, subset_px=31).register(current, POINTS)
    designed = prepare(noisy, POINTS, SubsetDesign(31)).register(current, POINTS)
    np.testing.assert_allclose(designed.position, plain.position, rtol=0, atol=1e-9)
    # In white noise the noise is found to be white.
    ratio = np.einsum("pkk->pk", designed.covariance) / np.einsum("pkk->pk", plain.covariance)
    np.testing.assert_allclose(ratio, 1, atol=0.2)


def test_shading_of_one_point_among_many_changes_no_other(texture, reference):
    current = digitize(texture.image(SHIFT))
    points = np.concatenate([POINTS, POINTS, POINTS])[:70]  # more than are prepared at one time
    mixed = [SubsetDesign(31)] * 69 + [SubsetDesign(31, shading=3)]
    found = SubsetBank.prepare(reference, points, designs=mixed).register(current, points)
    plain = prepare(reference, points, SubsetDesign(31)).register(current, points)
    np.testing.assert_allclose(found.position[:69], plain.position[:69], rtol=0, atol=1e-3)
    np.testing.assert_allclose(found.position[69], points[69] + SHIFT, rtol=0, atol=0.02)


@pytest.mark.parametrize("width_px", [0.7, 1.5])
def test_noise_that_is_smooth_is_stated_as_such(width_px):
    """A codec leaves errors that neighbouring pixels share: they average out less."""
    rng = np.random.default_rng(3)
    texture = NaturalTexture(4, size=512, cutoff=0.2)
    points = grid_points(512, 30, 40)
    frames = []
    for shift in ((0, 0), SHIFT):
        noise = gaussian_filter(rng.normal(0, 1, (512, 512)), width_px)
        frames.append(digitize(texture.image(shift) + 3 / noise.std() * noise, rng, 0.2))
    found = prepare(frames[0], points, SubsetDesign(31, Warp.TRANSLATION)).register(frames[1], points)
    error = found.position - points - SHIFT
    square = np.einsum("pi,pij,pj->p", error, np.linalg.inv(found.covariance), error) / 2
    assert 0.6 < square.mean() < 1.4


@pytest.mark.parametrize("warp", [Warp.TRANSLATION, Warp.AFFINE])
def test_shadows_do_not_pull_where_they_are_allowed_for(warp):
    """A soft shadow comes: a surface of the second degree, as strong as the texture."""
    rng = np.random.default_rng(5)
    texture = NaturalTexture(4, size=512, cutoff=0.2, contrast=8)
    points = grid_points(512, 30, 40)
    u, v = np.meshgrid(np.arange(512), np.arange(512))
    shadow = 0.1 * ((u % 30 - 10) ** 2 - (u % 30 - 10) * (v % 30 - 10) + 3 * (v % 30 - 10))
    frames = digitize(texture.image(), rng, 1.0), digitize(texture.image(SHIFT) + shadow, rng, 1.0)
    errors = {}
    for degree in (0, 2):
        found = prepare(frames[0], points, SubsetDesign(17, warp, shading=degree)).register(frames[1], points)
        errors[degree] = found.position - points - SHIFT
        if degree:
            square = np.einsum("pi,pij,pj->p", errors[2], np.linalg.inv(found.covariance), errors[2]) / 2
            assert np.nanmean(square) == pytest.approx(1, abs=0.25)
    assert np.nanmedian(np.abs(errors[2])) < 0.5 * np.nanmedian(np.abs(errors[0]))


@pytest.mark.parametrize("warp", [Warp.TRANSLATION, Warp.SIMILARITY, Warp.AFFINE])
def test_every_order_states_its_real_error(warp):
    rng = np.random.default_rng(3)
    texture = NaturalTexture(4, size=512, cutoff=0.2, exponent=1.5)
    points = grid_points(512, 30, 40)
    squares = []
    for shift in np.arange(0, 0.51, 0.1):
        frames = [digitize(texture.image(s), rng, NOISE) for s in ((0, 0), (shift, -shift))]
        found = prepare(frames[0], points, SubsetDesign(25, warp)).register(frames[1], points)
        assert found.converged.all()
        error = found.position - points - [shift, -shift]
        squares.append(np.einsum("pi,pij,pj->p", error, np.linalg.inv(found.covariance), error) / 2)
    assert np.mean(squares) == pytest.approx(1, abs=0.1)


def test_an_affine_warp_holds_where_the_texture_determines_less():
    """Coarse grains of little contrast, as of weathered concrete: with all six numbers some are lost by chance."""
    rng = np.random.default_rng(8)
    texture = NaturalTexture(5, cutoff=0.04, contrast=10)
    frames = [digitize(texture.image(s), rng, 0.7) for s in ((0, 0), SHIFT)]
    points = grid_points(SIZE, 20, 45)
    banks = [prepare(frames[0], points, SubsetDesign(41, warp)) for warp in (Warp.AFFINE, Warp.TRANSLATION)]
    affine, translation = (bank.register(frames[1], points) for bank in banks)

    def rms(found):
        return np.sqrt(np.nanmean((found.position - points - SHIFT) ** 2))

    freedoms = np.linalg.matrix_rank(banks[0].prepared[0][1].matrices[:, 0], rtol=1e-9)
    assert (freedoms < 6).all()
    assert len(set(freedoms.tolist())) > 2  # as many as each point's own grains tell
    for found in (affine, translation):
        assert found.converged.all()
        assert np.isfinite(found.covariance).all()
    assert rms(translation) < 0.05
    assert rms(affine) < 0.1


def test_an_edge_is_measured_across_and_says_that_it_is_not_along():
    rng = np.random.default_rng(2)
    design = SubsetDesign(41, Warp.EDGE, across=ACROSS)
    points = np.array([[60.0, 60.0], [41.3, 73.8]])
    along = np.array([-ACROSS[1], ACROSS[0]])
    errors, stated = [], []
    for moved in np.linspace(-0.8, 0.8, 80):
        frames = [digitize(edge_image(m), rng, 1.0) for m in (0.0, moved)]
        bank = prepare(frames[0], points, design)
        assert bank.usable.all()
        found = bank.register(frames[1], points)
        assert found.converged.all()
        step = found.position - points
        np.testing.assert_allclose(step @ along, 0, atol=1e-12)
        np.testing.assert_allclose(along @ found.covariance @ along, UNMEASURED_STD_PX**2, rtol=1e-9)
        errors.append(step @ ACROSS - moved)
        stated.append(ACROSS @ found.covariance @ ACROSS)
    assert np.sqrt(np.mean(np.square(errors))) < 0.01
    assert np.mean(np.square(errors) / stated) == pytest.approx(1, abs=0.25)


def test_pixels_that_are_not_believed_have_no_part():
    """The right half of the square shows a background that stands still and another one in every frame."""
    fore, behind, other = (NaturalTexture(seed, contrast=28) for seed in (1, 2, 3))
    mask = np.ones((41, 41), np.bool_)
    mask[:, 22:] = False
    point = np.array([[128.0, 120.0]])

    def frame(shift, background):
        image = fore.image(shift)
        image[:, 134:] = background.image()[:, 134:]
        return digitize(image)

    frames = frame((0, 0), behind), frame(SHIFT, other)
    for warp in (Warp.TRANSLATION, Warp.AFFINE):
        masked = prepare(frames[0], point, SubsetDesign(41, warp, mask=mask)).register(frames[1], point)
        np.testing.assert_allclose(masked.position - point, [SHIFT], atol=0.01)
        assert masked.correlation[0] > 0.999
    whole = prepare(frames[0], point, SubsetDesign(41, Warp.TRANSLATION)).register(frames[1], point)
    assert whole.correlation[0] < 0.9


def test_a_mask_is_counted_in_the_uncertainty():
    rng = np.random.default_rng(6)
    texture = NaturalTexture(4, size=512, cutoff=0.2)
    points = grid_points(512, 30, 40)
    v, u = np.ogrid[-20:21, -20:21]
    design = SubsetDesign(41, Warp.TRANSLATION, mask=u**2 + v**2 < 12**2)
    frames = [digitize(texture.image(s), rng, NOISE) for s in ((0, 0), SHIFT)]
    found = prepare(frames[0], points, design).register(frames[1], points)
    error = found.position - points - SHIFT
    square = np.einsum("pi,pij,pj->p", error, np.linalg.inv(found.covariance), error) / 2
    assert square.mean() == pytest.approx(1, abs=0.25)


def test_what_a_reduced_warp_leaves_out_is_known():
    """The mask's middle lies 15 px right of the named point: a rotation moves it up or down by 15 times itself."""
    texture = NaturalTexture(12, contrast=28, cutoff=0.15)
    mask = np.zeros((41, 41), np.bool_)
    mask[8:33, 26:] = True
    point, turned = np.array([[128.0, 120.0]]), 2e-3
    grad_u, grad_v = texture.gradients()
    u, v = np.meshgrid(np.arange(SIZE) - 128.0, np.arange(SIZE) - 120.0)
    frames = [
        digitize(image, dtype=np.uint16, scale=200)
        for image in (texture.image(), texture.image() + turned * (grad_u * v - grad_v * u))
    ]
    design = SubsetDesign(41, Warp.TRANSLATION, mask=mask, omitted_std=turned)
    bank = prepare(frames[0], point, design)
    error = (bank.register(frames[1], point).position - point)[0]
    leakage = bank.prepared[0][1].leakage[0]
    expected = leakage @ np.array([0, 0, -turned, 0, turned, 0])
    assert abs(expected[1] - 15 * turned) < 5 * turned
    np.testing.assert_allclose(error, expected, atol=0.08 * abs(expected).max())
    # What may have been left out is part of the stated covariance.
    assert np.sqrt(bank.register(frames[0], point).covariance[0, 1, 1]) > abs(expected[1])


def test_sizes_and_orders_mix_in_one_bank(texture, reference):
    current = digitize(texture.image(SHIFT))
    kinds = [SubsetDesign(21), None, SubsetDesign(41, Warp.TRANSLATION), SubsetDesign(21, Warp.SIMILARITY)]
    designs = [kinds[k % 4] for k in range(len(POINTS))]
    bank = SubsetBank.prepare(reference, POINTS, designs=designs)
    rows = np.arange(len(POINTS))[::-1].copy()
    found = bank.register(current, POINTS[rows], rows=rows)
    for row, position, covariance in zip(rows, found.position, found.covariance, strict=True):
        if designs[row] is None:
            assert np.isnan(position).all()
            assert np.isnan(covariance).all()
            assert not bank.usable[row]
            continue
        alone = prepare(reference, POINTS[[row]], designs[row]).register(current, POINTS[[row]])
        np.testing.assert_allclose(position, alone.position[0], rtol=0, atol=1e-9)
        np.testing.assert_allclose(covariance, alone.covariance[0], rtol=1e-9)


def test_the_grid_search_believes_the_same_pixels(reference):
    mask = np.ones((41, 41), np.bool_)
    mask[:, 22:] = False
    current = reference.copy()
    current[:, 134:] = 255 - current[:, 134:]
    point = np.array([[128.0, 120.0]])
    bank = prepare(reference, point, SubsetDesign(41, mask=mask))
    raw = bank.run_on_grid(current, np.array([0]), np.concatenate([point, [[1.0, 0, 0, 1]]], axis=1), divisions=16)
    assert raw.correlation[0] == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({"subset_px": 40}, SessionError, "odd number"),
        ({"warp": Warp.EDGE}, DatasetError, "across: expected a direction"),
        ({"across": ACROSS}, DatasetError, "across: expected a direction"),
        ({"warp": Warp.EDGE, "across": 2 * ACROSS}, DatasetError, "expected a unit vector"),
        ({"mask": np.ones((40, 41), np.bool_)}, DatasetError, "expected booleans of shape"),
        ({"mask": np.ones((41, 41))}, DatasetError, "expected booleans of shape"),
        ({"mask": np.zeros((41, 41), np.bool_)}, DatasetError, "believed pixels"),
        ({"omitted_std": -1.0}, DatasetError, "expected 0 or more"),
        ({"shading": 6}, DatasetError, "expected a degree from 0 to 5"),
    ],
)
def test_a_design_that_contradicts_itself_is_refused(settings, error, message):
    with pytest.raises(error, match=message):
        SubsetDesign(**settings)


def test_a_design_for_every_point(reference):
    with pytest.raises(DatasetError, match="expected one a point, got 1 for 2"):
        SubsetBank.prepare(reference, POINTS[:2], designs=[SubsetDesign()])
