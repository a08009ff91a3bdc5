"""What the documents show runs."""

from pathlib import Path

import torch

DOCS = Path(__file__).parents[3] / "docs"


def test_the_layer_trains_a_foreign_model():
    text = (DOCS / "layer-in-a-model.md").read_text()
    names = {}
    torch.manual_seed(0)
    exec(
        compile(text.split("```python\n")[1].split("```")[0], "layer-in-a-model.md", "exec"), names
    )
    parameters = dict(names["model"].named_parameters())
    assert parameters and all(
        p.grad is not None and p.grad.isfinite().all() for p in parameters.values()
    )
    assert all(p.grad.abs().sum() > 0 for name, p in parameters.items() if name.endswith("weight"))


def test_the_page_on_the_layer_differentiates_it_twice():
    names = {"torch": torch, "nn": torch.nn}
    exec(
        compile(
            (DOCS / "layer-in-a-model.md").read_text().split("```python\n")[2].split("```")[0],
            "layer-in-a-model.md",
            "exec",
        ),
        names,
    )
    assert names["label"].grad.isfinite().all() and names["label"].grad.abs().sum() > 0


def test_the_page_on_choosing_names_every_method():
    from learn.methods import NAMES

    text = (DOCS / "how-to-choose.md").read_text()
    assert [name for name in NAMES if f"`{name}`" not in text] == []
