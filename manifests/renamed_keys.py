"""Names that keys of run files and settings files had before, and files read by today's names.

Run files, the settings of refinement in settings.json, and the runs in the metadata of weights and
checkpoints were written with shorter names up to version 2 of runs. They are read by this table.
"""

from collections.abc import Mapping
from typing import Any

from manifests.errors import InputError

CURRENT_NAMES = {
    # of runs (manifests.training_runs)
    "rate": "learning_rate",
    "decay": "weight_decay",
    "average": "ema_decay",
    "pull": "gradient_bound",
    "matte_first": "gloss_curriculum",
    # of refinement (learn.refinement.settings)
    "passes": "outer_iterations",
    "reach": "trust_region",
    "together": "joint_iterations",
    "half_weight_colour": "unexplained_share_at_half_weight",
}

# {a key: {a later one beside it: the value that it had before it could be set}}
LATER_KEYS: dict[str, dict[str, Any]] = {
    # of refinement
    "trust_region": {
        "b_colour": 0.0,
        "unexplained_share_at_half_weight": None,
        "method": "auto",
    },
    # of the losses and the data of runs
    "layer_light": {"layer_method": "auto"},
    "sharing": {"layer_method": "auto"},
}


def current_name(name: str) -> str:
    """Return the name that a key has today."""
    return CURRENT_NAMES.get(name, name)


def with_current_names(values: Any, where: object = "settings", path: str = "") -> Any:
    """Return JSON values whose keys, at any depth, have the names of today, and LATER_KEYS.

    where   what names the file in an InputError; path: of these values in it, "stages[0]."
    Raises  InputError: a key that stands there under both names
    """
    if isinstance(values, list):
        place = path.removesuffix(".")
        return [with_current_names(v, where, f"{place}[{i}].") for i, v in enumerate(values)]
    if not isinstance(values, Mapping):
        return values
    for old, new in CURRENT_NAMES.items():
        if old in values and new in values:
            rule, both = f"one of '{old}' and '{new}', its name of today", "both"
            raise InputError(f"{where}: {path}{old}", rule, both, f"leave out '{old}'")
    result = {
        current_name(name): with_current_names(value, where, f"{path}{name}.")
        for name, value in values.items()
    }
    for beside, later in LATER_KEYS.items():
        if beside in result:
            result = later | result
    return result
