import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vfm_sdm.stages.matching.network_view import NetworkCanvas, network_view

_SIDE = st.integers(20, 5000)
_PIXEL = st.floats(-0.5, 5000)


@pytest.mark.parametrize(
    ("size", "resized"),
    [
        ((1920, 1080), (518, 294)),
        ((1080, 1920), (294, 518)),
        ((640, 480), (518, 392)),
        ((300, 300), (518, 518)),
        ((5000, 20), (518, 14)),
    ],
)
def test_pictures_are_resized_to_518_px_and_whole_patches(size, resized):
    canvas = NetworkCanvas.of(np.zeros((*size[::-1], 3), np.uint8))
    assert canvas.region.canvas_size == resized
    assert (canvas.left, canvas.top) == (0, 0)


class TestPixels:
    @given(_SIDE, _SIDE, st.integers(0, 500), st.integers(0, 500), _PIXEL, _PIXEL)
    def test_there_and_back(self, width, height, left, top, u, v):
        alone = NetworkCanvas.of(np.broadcast_to(np.uint8(0), (height, width, 3)))
        canvas = NetworkCanvas(alone.region, left, top)
        np.testing.assert_allclose(canvas.to_full(canvas.from_full(np.array([u, v]))), [u, v], rtol=0, atol=1e-9)
        np.testing.assert_allclose(canvas.from_full(canvas.to_full(np.array([u, v]))), [u, v], rtol=0, atol=1e-9)

    @given(_SIDE, _SIDE, st.integers(0, 500), st.integers(0, 500))
    def test_borders_of_the_picture_are_borders_of_its_window(self, width, height, left, top):
        alone = NetworkCanvas.of(np.broadcast_to(np.uint8(0), (height, width, 3)))
        canvas = NetworkCanvas(alone.region, left, top)
        rows, columns = canvas.window
        borders = np.array([[-0.5, -0.5], [width - 0.5, height - 0.5]])
        expected = np.array([[columns.start, rows.start], [columns.stop, rows.stop]]) - 0.5
        np.testing.assert_allclose(canvas.from_full(borders), expected, rtol=0, atol=1e-9)


class TestNetworkView:
    def test_smaller_ones_stand_in_the_middle_of_white(self):
        dark = [np.zeros((360, 640, 3), np.uint8), np.zeros((500, 300, 3), np.uint8)]
        view, canvases = network_view(dark)
        assert view.shape == (2, 518, 518, 3)
        assert [(c.left, c.top) for c in canvases] == [(0, 112), (105, 0)]
        for picture, canvas in zip(view, canvases, strict=True):
            assert (picture[canvas.window] == 0).all()
            picture[canvas.window] = 255
            assert (picture == 255).all()

    def test_of_one_size_have_no_white(self):
        view, _ = network_view([np.zeros((60, 80, 3), np.uint8)] * 3)
        assert view.shape == (3, 392, 518, 3)
        assert not view.any()

    @pytest.mark.parametrize("size", [(100, 60), (61, 97), (1400, 900)], ids=["enlarged", "portrait", "reduced"])
    def test_grey_values_stay_at_their_pixels(self, size):
        # A ramp along each axis survives resizing; half a pixel of the canvas would be eight times what is allowed.
        width, height = size
        ramp = np.zeros((height, width, 3))
        ramp[..., 0] = np.linspace(0, 255, width)
        ramp[..., 1] = np.linspace(0, 255, height)[:, None]
        view, (canvas, _) = network_view([np.rint(ramp).astype(np.uint8), np.zeros((50, 50, 3), np.uint8)])
        rows, columns = canvas.window
        v, u = np.mgrid[rows.start + 20 : rows.stop - 20, columns.start + 20 : columns.stop - 20]
        at = canvas.to_full(np.stack([u, v], axis=-1).astype(float))
        for channel, axis_length in ((0, width), (1, height)):
            expected = at[..., channel] * 255 / (axis_length - 1)
            difference = view[0, v, u, channel] - expected
            assert np.abs(difference).max() < 2
            assert abs(difference.mean()) < 0.03
