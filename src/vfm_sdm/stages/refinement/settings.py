"""Settings of the refinement as a session states them."""

from vfm_sdm.inputs.session import Sgr
from vfm_sdm.stages.refinement.model import SgrSettings
from vfm_sdm.stages.refinement.objective import SgrWeights

__all__ = ["sgr_settings"]


def sgr_settings(sgr: Sgr) -> SgrSettings:
    """Weights, suppressed axis and choice of the view, from the table ``[method.sgr]``.

    Parameters
    ----------
    sgr
        The table of the session.
    """
    weights = SgrWeights(sgr.longitudinal, sgr.longitudinal_rate, sgr.others, sgr.others_rate, sgr.pixel)
    return SgrSettings(weights, suppressed_axis=sgr.suppressed_axis, uncertain_view=sgr.uncertain_view)
