"""Small scenes, and independent second opinions on what a renderer must give."""

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter
from scipy.special import ndtri

from vfm_sdm.geometry.camera import Camera
from vfm_sdm.studies.synthetic.scene import Face, Scene, Texture


def plain_camera(width=64, height=48, *, focal_px=300.0, distortion=(), yaw=0.0):
    """A camera at the origin that looks along the longitudinal axis, turned by ``yaw`` towards the lateral one."""
    K = np.array([[focal_px, 0, (width - 1) / 2], [0, focal_px, (height - 1) / 2], [0, 0, 1]])
    R = np.array([[np.cos(yaw), 0, -np.sin(yaw)], [0, 1, 0], [np.sin(yaw), 0, np.cos(yaw)]])
    return Camera(K, (width, height), np.array(distortion), np.column_stack([R, np.zeros(3)]))


def plain_face(name, luma, corner, edge_u, edge_v, *, moving=False):
    """A face of one luma."""
    return Face(name, np.array(corner), np.array(edge_u), np.array(edge_v), Texture(0, luma, 0.0, (0.05, 0.05)), moving)


def nearest_faces(scene, directions, center, shift=(0.0, 0.0, 0.0)):
    """Index of the face that each ray meets first, -1 for none; all moving faces are shifted alike."""
    nearest = np.full(directions.shape[:-1], np.inf)
    index = np.full(directions.shape[:-1], -1)
    for k, face in enumerate(scene.faces):
        origin = face.origin + (np.asarray(shift) if face.moving else 0) - center
        normal = np.cross(face.edge_u, face.edge_v)
        with np.errstate(divide="ignore", invalid="ignore"):
            along = (origin @ normal) / (directions @ normal)
            hit = along[..., None] * directions - origin
        a, b = (hit @ edge / (edge @ edge) for edge in (face.edge_u, face.edge_v))
        seen = (along > 0) & (along < nearest) & (a >= 0) & (a <= 1) & (b >= 0) & (b <= 1)
        nearest, index = np.where(seen, along, nearest), np.where(seen, k, index)
    return index


def directions_at(camera: Camera, pixels):
    """World directions of the rays through pixels, shape (..., 2) to (..., 3)."""
    rays = camera.normalize(pixels)
    return np.concatenate([rays, np.ones((*rays.shape[:-1], 1))], axis=-1) @ camera.rotation


def blurred(scene: Scene, camera: Camera, *, sigma, shift=(0.0, 0.0, 0.0), count=987, generator=610):
    """Image of faces of one luma each through a Gaussian point spread, by brute force on a Fibonacci lattice."""
    width, height = camera.image_size
    n = np.arange(count)
    offsets = sigma * ndtri((np.column_stack([n, n * generator % count]) + 0.5) / count)
    luma = np.array([*(face.texture.mean for face in scene.faces), scene.sky])
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)
    image = np.zeros((height, width))
    for offset in offsets:
        directions = directions_at(camera, pixels + offset)
        image += luma[nearest_faces(scene, directions, camera.center, shift)] / count
    return image


def register(reference, current, center, *, half=20):
    """Shift of a subset from one image to another: least squares, affine, quintic splines; shape (2,) [px]."""
    u0, v0 = np.rint(center).astype(int)
    pad = half + 10
    window = (slice(v0 - pad, v0 + pad + 1), slice(u0 - pad, u0 + pad + 1))
    dv, du = np.mgrid[-half : half + 1, -half : half + 1].astype(float)
    target = reference[window][10:-10, 10:-10].astype(float)
    spline = spline_filter(current[window].astype(float), order=5)

    def sample(u, v):
        return map_coordinates(spline, [v + pad, u + pad], order=5, prefilter=False)

    p, h = np.zeros(6), 1e-3
    for _ in range(30):
        u, v = du + p[0] + p[1] * du + p[2] * dv, dv + p[3] + p[4] * du + p[5] * dv
        by_u, by_v = (sample(u + h, v) - sample(u - h, v)) / (2 * h), (sample(u, v + h) - sample(u, v - h)) / (2 * h)
        J = np.stack([by_u, by_u * du, by_u * dv, by_v, by_v * du, by_v * dv], axis=-1).reshape(-1, 6)
        step = np.linalg.lstsq(J, (target - sample(u, v)).ravel(), rcond=None)[0]
        p += step
        if np.abs(step).max() < 1e-8:
            break
    return p[[0, 3]] + p[[[1, 2], [4, 5]]] @ (np.asarray(center) - [u0, v0])
