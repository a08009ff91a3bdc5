"""The methods that Section 4.5 compares with, trained and run on our data; docs/baselines.md says what in them is ours."""

FILES = {"Lombardi-like": "lombardi.safetensors", "Baseline 1": "baseline-1.safetensors", "Baseline 2": "baseline-2.safetensors"}


def found(folder):
    """The methods whose files lie in a folder, and what is missing for the others.

    Returns  [learn.evaluation.methods.Method] in the paper's order, {name: why it is not there}
    Raises   Problem: a file is there and is not what its name says
    """
    from pathlib import Path

    from learn.baselines import methods
    from manifests.errors import Problem

    if not Path(folder).is_dir():
        raise Problem("--baselines", "a folder of weights", f"no folder {folder}", "train them: python -m learn baselines")
    present, missing = [], {}
    for name, file in FILES.items():
        path = Path(folder) / file
        if path.exists():
            present.append(methods.load(name, path))
        else:
            missing[name] = f"no {file} in {folder}: python -m learn baselines --out {folder}"
    return present, missing
