"""Choosing views of a rig and another reference."""

import numpy as np
import pytest

from boards import make_rig
from vfm_sdm.errors import CameraError
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.rig_views import select_views


def with_covariance(rig, seed=0):
    """The rig with a full covariance, without uncertainty of the first camera's pose."""
    spread = np.random.default_rng(seed).normal(size=(30, 60)) * np.tile([1e-3, 1, 1, 1e-2, *[1e-3] * 6], 3)[:, None]
    spread[4:10] = 0
    return Rig(rig.names, rig.cameras, True, spread @ spread.T / 60)


def test_same_views_give_the_same_rig():
    rig = with_covariance(make_rig(3))
    same = select_views(rig, rig.names)
    np.testing.assert_allclose(same.covariance, rig.covariance, atol=1e-18)
    for before, after in zip(rig.cameras, same.cameras, strict=True):
        np.testing.assert_allclose(after.cam_from_world, before.cam_from_world, atol=1e-12)


def test_covariance_follows_the_new_reference():
    # The derivative used against finite differences of the move itself.
    rig = with_covariance(make_rig(3))
    names = ("third", "right", "left")
    step = 1e-6

    def parameters(delta):
        moved = Rig.from_world(names, [rig.perturbed(delta).camera(name) for name in names], metric=True)
        reference = select_views(rig, names)
        values = []
        for camera, start in zip(moved.cameras, reference.cameras, strict=True):
            turn = camera.rotation @ start.rotation.T
            rotation = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
            intrinsics = [np.log(camera.focal_px), *camera.K[:2, 2], camera.distortion[0]]
            values += [*intrinsics, *rotation, *camera.translation]
        return np.array(values)

    J = np.stack([(parameters(step * e) - parameters(-step * e)) / (2 * step) for e in np.eye(30)], axis=-1)
    expected = J @ rig.covariance @ J.T
    found = select_views(rig, names).covariance
    np.testing.assert_array_equal(found[4:10], 0.0)
    scale = np.sqrt(np.diag(expected))
    scale[4:10] = 1.0  # no uncertainty of the new reference's pose
    assert np.abs((found - expected) / np.outer(scale, scale)).max() < 1e-6


def test_without_covariance_there_is_none_afterwards():
    chosen = select_views(make_rig(3), ("right", "third"))
    assert chosen.covariance is None
    assert chosen.names == ("right", "third")


def test_unknown_view_is_refused():
    with pytest.raises(CameraError, match="view 'top'"):
        select_views(make_rig(2), ("left", "top"))
