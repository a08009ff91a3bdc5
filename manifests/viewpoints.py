"""The 24 viewpoints: azimuth in degrees by number, from manifests/viewpoints.json."""

from functools import cache
from pathlib import Path

from manifests.reading import read

COUNT = 24


@cache
def azimuths_deg() -> tuple[float, ...]:
    """Return each viewpoint's azimuth, degrees about world z; 0 looks at the object's front."""
    return tuple(
        float(a) for a in read(Path(__file__).parent / "viewpoints.json", dict)["azimuth_deg"]
    )
