"""One clock for all views and sensors: how their clocks differ, and tracks brought to the reference view's stamps."""

from vfm_sdm.stages.synchronize.alignment import align_views
from vfm_sdm.stages.synchronize.dataset_lags import estimate_sensor_lag, estimate_view_lag, synchronize_views
from vfm_sdm.stages.synchronize.lag import LagSearch, Synchronization, estimate_lag
from vfm_sdm.stages.synchronize.signals import Samples
from vfm_sdm.stages.synchronize.views import synchronize_tracks

__all__ = [
    "LagSearch",
    "Samples",
    "Synchronization",
    "align_views",
    "estimate_lag",
    "estimate_sensor_lag",
    "estimate_view_lag",
    "synchronize_tracks",
    "synchronize_views",
]
