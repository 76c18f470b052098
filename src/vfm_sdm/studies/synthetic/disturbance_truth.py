"""What disturbed every frame of a virtual field test, as only a simulation can know it."""

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.studies.synthetic.disturbances import Disturbances, random_stream
from vfm_sdm.studies.synthetic.obstacles import Blob
from vfm_sdm.studies.synthetic.plan import Preset
from vfm_sdm.studies.synthetic.weather import count_streaks

__all__ = ["true_disturbances"]

_AXES = ("pitch", "yaw", "roll")


def true_disturbances(plan: Preset) -> xr.Dataset:
    """What disturbed every frame.

    Parameters
    ----------
    plan
        The field test.

    Returns
    -------
    dataset
        Dimensions (view, frame, ...), NaN beyond a view's last frame: ``time`` and ``stamp`` [s], the true time and
        the stamp of the view's clock; ``repeated`` (1 where a frame is the one before); ``gain`` [1] of its light;
        ``turn`` (axis) [urad], the camera's rotation; ``streaks`` of rain; ``hidden`` (point) [1], 1 where a passer
        or a leaf is in front of the place of a point at rest. Attributes: the settings of every view and the blunders.
    """
    views = [_view_truth(plan, view) for view in range(len(plan.views))]
    dataset = xr.concat(views, xr.Variable("view", list(plan.views)), join="outer")
    return dataset.assign_attrs(
        title="disturbances of a synthetic field test",
        disturbances=[repr(recording.disturbances) for recording in plan.recordings],
        blunders=[f"{blunder.reading}: {blunder.error_m:+.3f} m" for blunder in plan.blunders],
        bars_alike=int(getattr(plan.site, "bars_alike", False)),
    )


def _view_truth(plan: Preset, view: int) -> xr.Dataset:
    """Truth of one view's frames."""
    recording, time_s, repeated = plan.recordings[view], plan.frame_times(view), plan.repeated(view)
    settings, rain = recording.disturbances, random_stream(plan.seed, view, "rain")
    # What a repeated frame shows is of the frame before.
    shown = np.maximum.accumulate(np.where(repeated, 0, np.arange(len(time_s))))
    streaks = np.zeros(len(time_s))
    if settings.rain is not None:
        streaks = np.array([count_streaks(settings.rain, (*rain, number)) for number in range(len(time_s))])
    turns = np.zeros((len(time_s), 3))
    if settings.shake is not None:
        turns = 1e6 * settings.shake.turns(time_s, seed=random_stream(plan.seed, view, "shake"))
    gain = np.array([float(settings.gain(float(time), recording.exposure_s)) for time in time_s])
    return xr.Dataset(
        {
            "time": ("frame", time_s, {"units": "s"}),
            "stamp": ("frame", plan.stamps(view) / plan.fps, {"units": "s"}),
            "repeated": ("frame", repeated.astype(float)),
            "gain": ("frame", gain[shown], {"units": "1"}),
            "turn": (("frame", "axis"), turns[shown], {"units": "urad"}),
            "streaks": ("frame", streaks[shown].astype(float)),
            "hidden": (("frame", "point"), _hidden(plan, view, settings, time_s)[shown]),
        },
        coords={"frame": np.arange(len(time_s)), "axis": list(_AXES), "point": [point.name for point in plan.points]},
    )


def _hidden(plan: Preset, view: int, settings: Disturbances, time_s: FloatArray) -> FloatArray:
    """Whether something is in front of the places of points at rest, shape (frames, points), 0 or 1."""
    camera, seed = plan.site.cameras()[view], random_stream(plan.seed, view, "branches")
    places = camera.project([point.position for point in plan.points])
    hidden = np.zeros((len(time_s), len(places)))
    for number, time in enumerate(time_s):
        for _, blobs in settings.blobs(float(time), camera, seed=seed):
            for blob in blobs:
                hidden[number] += _inside(blob, places)
    return np.minimum(hidden, 1)


def _inside(blob: Blob, places: FloatArray) -> FloatArray:
    """1 for places inside a patch, else 0, shape (points,)."""
    away = np.abs(places - blob.center_px) / blob.half_px
    return np.asarray(np.sum(away**blob.power, axis=1) < 1, np.float64)
