"""The methods that Section 4.5 compares with, trained and run on our data.

docs/baselines.md states what in them is ours.
"""

FILES = {
    "Lombardi-like": "lombardi.safetensors",
    "Baseline 1": "baseline-1.safetensors",
    "Baseline 2": "baseline-2.safetensors",
}
