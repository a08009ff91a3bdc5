"""A job's own values, checked before anything that it names is read."""

from manifests.errors import InputError
from manifests.schema import CameraRanges, Draw, Job


def check(job: Job) -> None:
    """Raise InputError for values that repeat, draws of too many values, and empty ranges."""
    _check_ranges(job.camera_ranges)
    for key, most in (("views", 24), ("rotations", 128)):
        value = getattr(job, key)
        if isinstance(value, Draw):
            if value.random > most:
                raise InputError(
                    f"job: {key}.random",
                    f"at most {most}",
                    str(value.random),
                    f"there are {most} different ones",
                )
        elif len(set(value)) < len(value):
            raise InputError(
                f"job: {key}",
                "each number once",
                f"{sorted({v for v in value if value.count(v) > 1})} twice",
                "name each once",
            )
    for key in ("tiers", "light_resolutions"):
        value = getattr(job, key)
        if len(set(value)) < len(value):
            raise InputError(f"job: {key}", "each name once", ", ".join(value), "name each once")


def _check_ranges(ranges: CameraRanges | None) -> None:
    """Raise InputError for a range whose lowest value is above its highest."""
    for key in ("elevation_deg", "roll_deg", "fov_deg"):
        span = getattr(ranges, key, None)
        if span and span[0] > span[1]:
            raise InputError(
                f"job: camera_ranges.{key}",
                "[lowest, highest]",
                f"[{span[0]:g}, {span[1]:g}]",
                "write the lower value first",
            )
