"""Long recordings behind tracking: measured and judged interval by interval, with memory that does not grow."""

from vfm_sdm.stages.intervals.carried import Carried
from vfm_sdm.stages.intervals.measure import MeasuredInterval, measure_intervals

__all__ = ["Carried", "MeasuredInterval", "measure_intervals"]
