"""Networks that know the truth, to test what is around them: resizing, focal lengths, frames, scale, statuses."""

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from small_networks import posediffusion_on_cpu, vggt_on_cpu
from vfm_sdm.inputs.session import FirstFrames, Network
from vfm_sdm.inputs.video.camera_tags import CameraTags
from vfm_sdm.networks.vggt.pose import encode_pose
from vfm_sdm.stages.cameras.base import find_estimator
from vfm_sdm.stages.matching.network_view import network_view

UNIT_M = 20.0
"""What it takes for a length of one."""
_WORLD = Rotation.from_rotvec([0.3, -0.2, 0.1]).as_matrix()
_ORIGIN = np.array([0.1, 0.2, -0.3])


class KnownCameras:
    """In place of `VggtInference`: pose vectors of the true cameras of the pictures it is shown, in a world of its own.

    Parameters
    ----------
    rig
        True cameras.
    pictures
        Shape (height, width, 3) each; it knows no others.
    resized
        Width and height that each picture has for the network.
    """

    def __init__(self, rig, pictures, resized):
        self.pictures, _ = network_view(pictures)
        stretch = [np.divide(new, camera.image_size) for new, camera in zip(resized, rig.cameras, strict=True)]
        K = np.array([c.K * np.array([[u], [v], [1]]) for c, (u, v) in zip(rig.cameras, stretch, strict=True)])
        pose = np.array([c.cam_from_world for c in rig.cameras])
        pose[:, :, 3] = pose[:, :, 3] / UNIT_M + pose[:, :, :3] @ _ORIGIN
        pose[:, :, :3] = pose[:, :, :3] @ _WORLD
        size = tuple(max(side) for side in zip(*resized, strict=True))
        self.poses = encode_pose(pose, K, size)

    def estimate_poses(self, images):
        return self.poses[[next(k for k, p in enumerate(self.pictures) if np.array_equal(p, i)) for i in images]]


class KnownGuidedCameras:
    """In place of `PoseDiffusionInference`: the true cameras of the pictures it is shown, in a world of its own.

    Parameters
    ----------
    rig
        True cameras.
    pictures
        Shape (height, width, 3) each; it knows no others.
    """

    def __init__(self, rig, pictures):
        self.pictures = pictures
        self.cam_from_world = np.array([c.cam_from_world for c in rig.cameras])
        self.cam_from_world[:, :, 3] = self.cam_from_world[:, :, 3] / UNIT_M + self.cam_from_world[:, :, :3] @ _ORIGIN
        self.cam_from_world[:, :, :3] = self.cam_from_world[:, :, :3] @ _WORLD
        self.focal_px = np.array([c.K[[0, 1], [0, 1]] for c in rig.cameras])
        self.guided, self.agreeing, self.matches = True, 1.0, None

    def estimate_poses(self, pictures, matches=()):
        from vfm_sdm.networks.posediffusion.inference import GuidedPoses

        self.matches = matches
        chosen = [next(k for k, p in enumerate(self.pictures) if np.array_equal(p, one)) for one in pictures]
        parts = [np.arange(len(m)) < self.agreeing * len(m) for m in matches]
        near = np.concatenate([np.zeros(0, dtype=bool), *parts])
        return GuidedPoses(self.cam_from_world[chosen], self.focal_px[chosen], near, self.guided)


def as_colors(frames):
    """Grey pictures (height, width, 3) of luma by view name."""
    return [np.repeat(frame[..., None], 3, axis=2) for frame in frames.values()]


class Pictures(FirstFrames):
    """First frames that are no file: luma (H, W) by view, grey as colours."""

    @property
    def pixel_aspects(self) -> dict[str, float]:
        return dict.fromkeys(self._luma, 1.0)

    @property
    def camera_tags(self) -> dict[str, CameraTags]:
        return dict.fromkeys(self._luma, CameraTags())

    def __init__(self, luma):
        self._luma = dict(luma)
        self.__dict__["colors"] = dict(zip(luma, as_colors(luma), strict=True))
        self.__dict__["quiet"] = dict(luma)


def write_pictures(folder, names, pictures):
    """One image file a view."""
    for name, picture in zip(names, pictures, strict=True):
        cv2.imwrite(str(folder / f"{name}.png"), np.ascontiguousarray(picture[..., ::-1]))


def with_pictures(session):
    """The session with the files of `write_pictures` for its recordings."""
    views = [
        view.model_copy(update={"video": None, "images": f"{view.name}.png", "fps": 30.0}) for view in session.view
    ]
    return session.model_copy(update={"view": tuple(views)})


def network_cameras(name, folder, inference=None):
    """The estimator of this name with a stand-in, or else with a small network of random weights."""
    weights = folder / "random.safetensors"
    weights.write_bytes(b"stands for weights")
    estimator = find_estimator(name, network=Network(weights=str(weights), device="cpu"))
    small = {"vggt": lambda: vggt_on_cpu(track=False), "posediffusion": posediffusion_on_cpu}
    estimator.__dict__["inference"] = inference or small[name]()
    return estimator


def vggt_cameras(folder, inference=None):
    """`network_cameras` of the name ``vggt``."""
    return network_cameras("vggt", folder, inference)
