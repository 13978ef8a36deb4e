"""The options of a curved earth, which studies of sight, skylines and the sun share."""

from dataclasses import dataclass

import numpy as np

from ...base.checks import flag
from ...base.option_fields import RealNumber, option


@dataclass(frozen=True, kw_only=True)
class CurvatureOptions:
    """The curvature of the earth, and refraction."""

    curvature: bool = option(False, flag, "Account for the curvature of the earth.")
    """Account for earth curvature around each observer."""
    refraction: float | None = option(
        None,
        RealNumber(-1.0, 1.0, optional=True),
        "Refraction coefficient: share of the curvature that refraction offsets.",
        note="0.13; 0 on bodies other than the earth",
    )
    """Share k of the curvature that refraction compensates; 0 for straight light. None: 0.13, or 0 if the CRS is that
    of another body."""
    earth_radius: float | None = option(
        None,
        RealNumber(0.0, np.inf, optional=True),
        "Radius of the earth in world units.",
        note="of the CRS's ellipsoid there, or 6371 km",
    )
    """World units. None: the mean radius of curvature, sqrt(M N), of the CRS's ellipsoid at the middle of the scene;
    without a CRS 6,371,000 m."""
