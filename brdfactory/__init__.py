"""Edit the material of a photographed object, make data sets, and use the rendering layer.

    import brdfactory as bf

    edited = bf.edit("photo.jpg", "mask.png", material="brass")
    edited.save("brass.png")
    edited.decomposition.paint("red-fabric").save("fabric.png")

Pictures and masks are paths or arrays; results are arrays, and nothing is written unless `save` is
called. Importing this package is quick: torch and Blender are loaded by the first call that needs
them.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from brdfactory.datasets import generate, load_job
    from brdfactory.editing import Decomposition, EditedPicture, decompose, edit
    from brdfactory.masks import make_mask
    from brdfactory.materials import Material, blend, material
    from brdfactory.pictures import Picture
    from brdfactory.rendering import light, render
    from learn.data.records import Records
    from learn.layer import RenderLayer
    from manifests.errors import InputError
    from manifests.schema import Job

# public name → the module that defines it
_HOMES = {
    "edit": "brdfactory.editing",
    "decompose": "brdfactory.editing",
    "Decomposition": "brdfactory.editing",
    "EditedPicture": "brdfactory.editing",
    "make_mask": "brdfactory.masks",
    "Picture": "brdfactory.pictures",
    "material": "brdfactory.materials",
    "blend": "brdfactory.materials",
    "Material": "brdfactory.materials",
    "light": "brdfactory.rendering",
    "render": "brdfactory.rendering",
    "RenderLayer": "learn.layer",
    "Records": "learn.data.records",
    "Job": "manifests.schema",
    "load_job": "brdfactory.datasets",
    "generate": "brdfactory.datasets",
    "InputError": "manifests.errors",
}

__all__ = [
    "Decomposition",
    "EditedPicture",
    "InputError",
    "Job",
    "Material",
    "Picture",
    "Records",
    "RenderLayer",
    "blend",
    "decompose",
    "edit",
    "generate",
    "light",
    "load_job",
    "make_mask",
    "material",
    "render",
]


def __getattr__(name: str) -> Any:
    """Import a public name's module when the name is first used.

    Raises  ImportError that names the extra to install, if a package is missing
    """
    if name not in _HOMES:
        raise AttributeError(f"module 'brdfactory' has no attribute {name!r}")
    try:
        value = getattr(import_module(_HOMES[name]), name)
    except ModuleNotFoundError as error:
        from manifests.errors import missing_package

        if (missing := missing_package(error)) is None:
            raise
        raise ImportError(f"brdfactory.{name} needs {missing}") from None
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
