import numpy as np
import pytest

from vfm_sdm.errors import DatasetError
from vfm_sdm.studies.synthetic.imager import Imager


def test_luma_is_rounded_and_stays_within_the_range_of_video():
    luma = np.array([[-5.0, 16.4, 99.5001, 300.0]], np.float32)
    frame = Imager((4, 1), noise_std=0.0).expose(luma, 0)
    np.testing.assert_array_equal(frame, [[16, 16, 100, 235]])
    assert frame.dtype == np.uint8


def test_noise_has_its_standard_deviation_and_follows_the_seed_and_the_number():
    luma = np.full((150, 200), 120.0, np.float32)
    imager = Imager((200, 150), noise_std=2.0, seed=(3, 1))
    frame = imager.expose(luma, 7)
    assert frame.std() == pytest.approx(np.hypot(2.0, np.sqrt(1 / 12)), rel=0.02)
    assert frame.mean() == pytest.approx(120, abs=0.05)
    np.testing.assert_array_equal(frame, Imager((200, 150), noise_std=2.0, seed=(3, 1)).expose(luma, 7))
    for other in (imager.expose(luma, 8), Imager((200, 150), noise_std=2.0, seed=(4, 1)).expose(luma, 7)):
        assert abs(np.corrcoef(frame.ravel(), other.ravel())[0, 1]) < 0.02


@pytest.mark.parametrize("std", [-1.0, np.nan, np.inf])
def test_refuses_noise_that_is_none(std):
    with pytest.raises(DatasetError, match="noise_std: expected luma units >= 0"):
        Imager((4, 4), noise_std=std)


def test_refuses_a_picture_of_another_size():
    with pytest.raises(DatasetError, match=r"luma: expected shape \(3, 4\), got \(4, 3\)"):
        Imager((4, 3), noise_std=0.0).expose(np.zeros((4, 3), np.float32), 0)
