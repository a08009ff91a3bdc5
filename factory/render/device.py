"""Which processor Cycles renders on: the CPU, or a GPU of one of Cycles' back ends."""

import bpy

from manifests.errors import InputError

# fastest first: the order in which `auto` tries them
BACKENDS = ("OPTIX", "CUDA", "HIP", "ONEAPI", "METAL")
NAMES = ("auto", "cpu", *(name.lower() for name in BACKENDS))


def choose(device: str) -> tuple[str, str, tuple[str, ...]]:
    """Make Cycles render on a device, and return which one it is.

    device   one of NAMES; auto: the first back end that has a GPU, else the CPU
    Returns  ("CPU" or "GPU", back end or "CPU", names of the processors)
    Raises   InputError for a back end without a GPU
    """
    if device not in NAMES:
        raise InputError("--device", f"one of {', '.join(NAMES)}", device, "name one of these")
    requested = BACKENDS if device == "auto" else () if device == "cpu" else (device.upper(),)
    preferences = bpy.context.preferences.addons["cycles"].preferences
    for backend in requested:
        gpus = _gpus(preferences, backend)
        if gpus:
            for processor in preferences.devices:
                processor.use = processor.type == backend
            return "GPU", backend, tuple(gpu.name for gpu in gpus)
    if requested and device != "auto":
        raise InputError(
            "--device",
            f"a GPU that Cycles can use through {device}",
            "none",
            "use --device cpu or auto, or check the driver",
        )
    preferences.compute_device_type = "NONE"
    return "CPU", "CPU", ()


def _gpus(preferences: bpy.types.AddonPreferences, backend: str) -> list:
    """Return the GPUs of one back end."""
    try:
        preferences.compute_device_type = backend
    except TypeError:  # Blender was built without this back end
        return []
    preferences.refresh_devices()
    return [processor for processor in preferences.devices if processor.type == backend]
