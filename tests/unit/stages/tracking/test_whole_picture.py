"""Whole pictures that move: found where a camera moves far, and left alone where it does not."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from vfm_sdm.stages.tracking.design.whole_picture import PictureMotion, cut_turned

WIDE = 200.0 * gaussian_filter(np.random.default_rng(0).normal(0, 1, (520, 640)), 1.6)
WIDE = np.clip(128 + 160 * WIDE / np.abs(WIDE).max(), 0, 255)


def picture(homography=None, depth=np.uint8):
    """A frame of 400 x 300 px out of a wide texture, seen through a homography from the first frame."""
    home = np.array([[1.0, 0.0, 120.0], [0.0, 1.0, 110.0], [0.0, 0.0, 1.0]])
    whole = home if homography is None else home @ np.linalg.inv(homography)
    seen = cv2.warpPerspective(WIDE, whole, (400, 300), flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP)
    noisy = seen + np.random.default_rng(1).normal(0, 2, seen.shape)
    return np.clip(np.rint(noisy * (np.iinfo(depth).max // 255)), 0, np.iinfo(depth).max).astype(depth)


def turned(angle_deg=2.0, scale=1.02, shift=(40.0, -25.0)):
    return np.vstack([cv2.getRotationMatrix2D((200, 150), angle_deg, scale), [0, 0, 1]]) + np.array(
        [[0, 0, shift[0]], [0, 0, shift[1]], [0, 0, 0]]
    )


@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
def test_a_camera_that_moved_far_is_found(depth):
    H = turned()
    found = PictureMotion(picture(depth=depth)).find(picture(H, depth))
    places = np.array([[[100.0, 80.0], [300.0, 80.0], [200.0, 220.0]]])
    apart = cv2.perspectiveTransform(places, found) - cv2.perspectiveTransform(places, H)
    assert np.abs(apart).max() < 0.5


def test_windows_are_turned_back():
    H, frame = turned(), picture(turned())
    window = cut_turned(frame, np.array([200, 150]), 30, H).astype(float)
    home = picture()[120:181, 170:231].astype(float)
    assert window.shape == home.shape
    assert np.corrcoef(window.ravel(), home.ravel())[0, 1] > 0.98


def test_a_camera_that_stays_costs_nothing():
    motion = PictureMotion(picture())
    assert motion.find(picture(turned(0.0, 1.0, (2.0, 1.0)))) is None
    assert motion.find(np.clip(0.6 * picture() + 30, 0, 255).astype(np.uint8)) is None
    assert motion._features is None  # nobody looked for any


def test_what_shows_nothing_known_is_no_motion():
    other = np.random.default_rng(3).integers(0, 255, (300, 400), np.uint8)
    motion = PictureMotion(picture())
    assert motion.find(other) is None
    assert motion.find(np.full((300, 400), 90, np.uint8)) is None
