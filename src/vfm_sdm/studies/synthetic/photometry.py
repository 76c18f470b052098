"""What a lens and a sensor make of linear light: blur by depth, vignetting, photon noise, tone curve.

Frames are float32, shape (H, W), linear in light, with black at 16 and white at 235 as in
`vfm_sdm.studies.synthetic.defects`, until the tone curve.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray, as_float_array
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.studies.synthetic.defects import BLACK, WHITE, Frame, defocus

__all__ = ["DepthBlur", "Photometry", "compute_blur", "compute_vignetting"]

_BLUR_STEP_PX = 0.5
"""Distance between the blurred frames that are mixed; the error of mixing is of fourth order in it."""
_TOE, _TOE_SLOPE, _POWER, _SCALE = 0.018, 4.5, 0.45, 1.099


@dataclass(frozen=True)
class Photometry:
    """Lens and sensor of a camera.

    Parameters
    ----------
    aperture_mm
        Diameter of the lens's entrance pupil [mm]; 0 for a pinhole, which is sharp everywhere.
    focus_m
        Distance in focus [m].
    vignetting
        Share of the light that is lost in the farthest corner of the picture [1].
    full_well_e
        Number of electrons of a white pixel; their square root is its noise. 0 for no photon noise.
    read_noise_e
        Standard deviation of the noise of a black pixel [electrons].
    shoulder
        How much the tone curve lifts what is dark at the cost of what is bright [1].

    Raises
    ------
    DatasetError
        A number is out of its range.

    Notes
    -----
    The variance of a pixel of E electrons is ``read_noise_e^2 + E``. The tone curve is that of video after a shoulder:
    ``x = (1 + s) L / (1 + s L)``, then ``4.5 x`` below 0.018 and ``1.099 x^0.45 - 0.099`` above.

    References
    ----------
    .. [1] Recommendation ITU-R BT.709-6 (2015), item 1.2: opto-electronic transfer characteristics.
    .. [2] European Machine Vision Association (2021). EMVA Standard 1288, release 4.0: the linear camera model.

    Examples
    --------
    >>> camera = Photometry(full_well_e=10000, read_noise_e=5)
    >>> round(float(camera.noise_std(np.array(235.0))), 2), round(float(camera.noise_std(np.array(16.0))), 2)
    (2.19, 0.11)
    >>> camera.tone(np.array([16.0, 55.42, 235.0])).round(1).tolist()
    [16.0, 105.6, 235.0]
    """

    aperture_mm: float = 0.0
    focus_m: float = 20.0
    vignetting: float = 0.0
    full_well_e: float = 0.0
    read_noise_e: float = 0.0
    shoulder: float = 0.0

    def __post_init__(self) -> None:
        least = min(self.aperture_mm, self.full_well_e, self.read_noise_e, self.shoulder)
        if not (least >= 0 and self.focus_m > 0 and 0 <= self.vignetting < 1):
            raise DatasetError(
                "photometry: expected aperture, electrons and shoulder >= 0, focus > 0 m and vignetting in [0, 1), got "
                f"{self}; correct them"
            )

    def noise_std(self, luma: FloatArray) -> FloatArray:
        """Standard deviation of the noise of linear light, shape (...) [luma units].

        Parameters
        ----------
        luma
            Linear light, shape (...), black is 16 and white 235.
        """
        if self.full_well_e == 0:
            return np.zeros(np.shape(luma))
        electrons = self.full_well_e * np.maximum((luma - BLACK) / (WHITE - BLACK), 0)
        return np.asarray(np.sqrt(self.read_noise_e**2 + electrons) * (WHITE - BLACK) / self.full_well_e)

    def tone(self, luma: FloatArray) -> FloatArray:
        """Luma as video holds it, shape (...).

        Parameters
        ----------
        luma
            Linear light, shape (...), black is 16 and white 235; limited to these.
        """
        light = np.clip((luma - BLACK) / (WHITE - BLACK), 0, 1)
        x = (1 + self.shoulder) * light / (1 + self.shoulder * light)
        video = np.where(x < _TOE, _TOE_SLOPE * x, _SCALE * x**_POWER - (_SCALE - 1))
        return np.asarray(BLACK + (WHITE - BLACK) * video)


def compute_blur(photometry: Photometry, focal_px: float, depth_m: FloatArray) -> FloatArray:
    """Standard deviation along each direction of a thin lens's disc of confusion, shape (...) [px].

    Parameters
    ----------
    photometry
        Aperture A and distance D in focus.
    focal_px
        Focal length f [px].
    depth_m
        Distances z along the optical axis, shape (...) [m]; may be infinite.

    Notes
    -----
    The disc's diameter is ``f A |1/z - 1/D|`` for distances that are large against the focal length; a uniform disc has
    a quarter of its diameter as standard deviation.

    Examples
    --------
    >>> compute_blur(Photometry(aperture_mm=20.0, focus_m=20.0), 8000.0, np.array([20.0, 40.0, np.inf])).tolist()
    [0.0, 1.0, 2.0]
    """
    aperture_m = 1e-3 * photometry.aperture_mm
    return np.asarray(0.25 * focal_px * aperture_m * np.abs(1 / depth_m - 1 / photometry.focus_m))


class DepthBlur:
    """Blurs frames by a standard deviation of its own at each pixel.

    Parameters
    ----------
    sigma_px
        Standard deviations, shape (H, W) [px].

    Raises
    ------
    DatasetError
        A standard deviation is negative or not finite.

    Notes
    -----
    Frames blurred in steps of half a pixel are mixed in proportion to the variance, which is exact for a blur much
    smaller than the detail. A pixel takes what is around it at its own blur, so that what is sharp leaks into what is
    not; draw what is far behind as a backdrop.
    """

    def __init__(self, sigma_px: FloatArray) -> None:
        sigma = as_float_array(sigma_px, "sigma_px", (None, None))
        if not (np.isfinite(sigma).all() and sigma.min(initial=0) >= 0):
            raise DatasetError("sigma_px: expected finite values >= 0, got others; check aperture and depths")
        self._levels = _BLUR_STEP_PX * np.arange(int(np.ceil(sigma.max(initial=0) / _BLUR_STEP_PX)) + 1)
        number = np.searchsorted(self._levels[1:], sigma)
        self._weights = []
        for n in range(len(self._levels)):
            below, above = (self._levels[max(0, n + step)] ** 2 for step in (-1, 0))
            rising = np.where(number == n - 1, (sigma**2 - below) / max(above - below, 1e-12), 0)
            following = self._levels[min(n + 1, len(self._levels) - 1)] ** 2
            falling = np.where(number == n, 1 - (sigma**2 - above) / max(following - above, 1e-12), 0)
            self._weights.append((rising + falling).astype(np.float32))

    def __call__(self, luma: Frame) -> Frame:
        """The blurred frame, shape (H, W)."""
        if len(self._levels) == 1:
            return luma
        blurred: Frame = np.zeros_like(luma)
        for sigma, weight in zip(self._levels, self._weights, strict=True):
            if weight.any():
                blurred += weight * defocus(luma, float(sigma))
        return blurred


def compute_vignetting(photometry: Photometry, camera: Camera) -> npt.NDArray[np.float32]:
    """Share of the light that reaches each pixel, shape (H, W) [1].

    Parameters
    ----------
    photometry
        Share that is lost in the farthest corner.
    camera
        Its principal point is where all light arrives.

    Notes
    -----
    ``(1 + c r^2)^-2``, the law of the fourth power of the cosine, with c from the loss in the corner.

    Examples
    --------
    >>> camera = Camera(np.array([[1000.0, 0.0, 31.5], [0.0, 1000.0, 23.5], [0.0, 0.0, 1.0]]), (64, 48))
    >>> share = compute_vignetting(Photometry(vignetting=0.3), camera)
    >>> round(float(share[0, 0]), 3), round(float(share.max()), 3)
    (0.7, 1.0)
    """
    width, height = camera.image_size
    u, v = np.arange(width) - camera.K[0, 2], np.arange(height)[:, None] - camera.K[1, 2]
    square = u**2 + v**2
    c = (1 / np.sqrt(1 - photometry.vignetting) - 1) / square.max()
    return np.asarray((1 + c * square) ** -2, np.float32)
