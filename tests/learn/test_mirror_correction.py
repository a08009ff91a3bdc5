"""Mirror-like target materials are rendered darker; materials of the photograph itself are not."""

import json

import numpy as np
import pytest
import torch

from learn.editing import decomposition, light_colour, mirror_correction, targets
from learn.editing.compositor import Compositor
from learn.editing.edit import EditOptions, make_edits
from learn.evaluation.methods import AsEdited, Layered, render_by_layer
from learn.layer import predictions
from learn.layer.albedo import narrow_share
from manifests.errors import InputError
from manifests.materials import load_catalogue
from manifests.progress import tqdm
from shaders.dsbrdf import SHAPE
from tests.support.known_ball import NETWORK, Knowing, label_of, lit, opened


def lobes(*shapes: tuple[float, float]) -> np.ndarray:
    """Return the label (108,) of lobes of given (κ, γ), the same in all channels and at all θ_d."""
    m = np.full(SHAPE, 1e-9)
    for number, (kappa, gamma) in enumerate(shapes):
        m[:, number, 0], m[:, number, 1] = kappa, gamma
    return np.log(m).ravel()


def test_the_share_is_that_of_albedo_in_narrow_lobes() -> None:
    matte, narrow = (0.1, 1e-3), (3.0, 1000.0)
    assert narrow_share(lobes(matte)) < 0.01
    assert narrow_share(lobes(narrow)) > 0.99
    both = narrow_share(lobes(matte, narrow))
    twice = narrow_share(lobes(matte, narrow, narrow))
    # of albedos a and b the share is b / (a + b), and 2b / (a + 2b)
    assert twice / (1 - twice) == pytest.approx(2 * both / (1 - both), rel=0.05)


def test_a_black_material_has_a_share_too() -> None:
    assert 0 <= narrow_share(np.full(108, -40.0)) <= 1


def test_metals_are_darkened_and_matte_materials_are_not() -> None:
    factors = {m.name: mirror_correction.factor(m.label) for m in load_catalogue().values()}
    assert len(factors) > 100 and all(0 < each <= 1 for each in factors.values())
    full = 2**-mirror_correction.STOPS
    for name in ("chrome", "chrome-steel", "steel"):
        assert factors[name] == pytest.approx(full, rel=0.02)
    for name in ("spectralon", "beige-fabric", "pink-plastic", "neoprene-rubber"):
        assert factors[name] > 0.95


def test_a_target_is_darkened_once_and_the_photographs_own_material_never() -> None:
    own, metal = label_of("blue-rubber"), label_of("chrome-steel")[0]
    radiance, inside = lit(own, 0.5)
    painter = Compositor(
        decomposition.decompose(opened(radiance, inside.astype(np.int64)), Knowing(own), NETWORK)
    )
    mine = painter.own_labels[0]
    assert painter.mirror_correction(mine) == 1
    assert painter.mirror_correction(metal) == np.float32(mirror_correction.factor(metal)) < 0.7
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mirror_correction, "STOPS", 0.0)
        plain = {"own": painter.radiance(mine[None]), "metal": painter.radiance(metal[None])}
    np.testing.assert_array_equal(painter.radiance(mine[None]), plain["own"])
    np.testing.assert_allclose(
        painter.radiance(metal[None]), mirror_correction.factor(metal) * plain["metal"], rtol=1e-5
    )


def test_a_material_that_was_read_from_another_picture_is_not_darkened() -> None:
    own, metal = label_of("blue-rubber"), label_of("chrome-steel")[0]
    radiance, inside = lit(own, 0.5)
    painter = Compositor(
        decomposition.decompose(opened(radiance, inside.astype(np.int64)), Knowing(own), NETWORK)
    )
    named = painter.edit([metal])
    assert painter.mirror_correction(metal, [metal.copy()]) == 1
    core = inside & (named.sum(-1) > 1e-3)
    read = painter.edit([metal], [metal])
    ratio = read[core].sum() / named[core].sum()
    assert ratio == pytest.approx(1 / mirror_correction.factor(metal), rel=0.02)


def test_edit_darkens_a_name_and_not_a_file_of_the_same_label(tmp_path) -> None:
    own, metal = label_of("blue-rubber"), label_of("chrome-steel")[0]
    radiance, inside = lit(own, 0.5)
    file = tmp_path / "material.json"
    file.write_text(json.dumps({"label": [float(x) for x in metal]}))
    picture = opened(radiance, inside.astype(np.int64))
    options = EditOptions(tmp_path / "weights", None, predictions.SHOWN.tolerance, 0.0)
    texts = ["chrome-steel", str(file)]
    with tqdm(total=9, disable=True) as progress:
        labels = {text: [metal] for text in texts}
        size = {"size": NETWORK}
        edits = make_edits(picture, labels, Knowing(own), size, options, progress).edits
    named, read = (each.picture[inside].mean() for each in edits)
    assert named / read == pytest.approx(mirror_correction.factor(metal), rel=0.02)


def test_files_are_read_and_names_are_not(tmp_path) -> None:
    picture, file = tmp_path / "brass.png", tmp_path / "material.json"
    picture.write_bytes(b"")
    label = [float(x) for x in label_of("chrome")[0]]
    file.write_text(json.dumps({"label": label}))
    assert targets.is_from_picture(str(picture)) and targets.is_from_picture(str(file))
    file.write_text(json.dumps({"labels": [label, label], "read": [True, False]}))
    both = [np.zeros(108, np.float32), np.ones(108, np.float32)]
    assert targets.labels_from_pictures(str(file), both)[0] is both[0]
    assert len(targets.labels_from_pictures(str(file), both)) == 1
    file.write_text(json.dumps({"label": label, "read": [True, False]}))
    with pytest.raises(InputError, match="one for each label"):
        targets.is_from_picture(str(file))
    for text in ("brass", "keep", "principled(metallic=1)"):
        assert not targets.is_from_picture(text)
    labels = [np.zeros(108, np.float32), None, np.ones(108, np.float32)]
    found = targets.labels_from_pictures(f"brass+keep+{picture}", labels)
    assert len(found) == 1 and found[0] is labels[2]
    assert targets.labels_from_pictures(str(picture), [labels[0]] * 3) == [labels[0]] * 3


def test_the_row_as_edited_has_the_corrections_of_edit() -> None:
    own, metal = label_of("blue-rubber"), label_of("chrome-steel")[0]
    radiance, inside = lit(own, 0.5)
    result = decomposition.decompose(
        opened(radiance, inside.astype(np.int64)), Knowing(own), NETWORK
    )
    tint = torch.tensor([1.0, 1.4, 0.9])[:, None, None]
    read = result.start._replace(light=result.start.light * tint)
    corrected = AsEdited(Layered("ours", lambda batch: read))
    assert corrected.name == "ours, as edited"
    right = light_colour.remove_green(decomposition.require_parts(read))
    assert torch.equal(corrected.parts(result.batch).light, right.light)
    assert not torch.equal(right.light, read.light)
    target = torch.from_numpy(metal)[None]
    shown = render_by_layer(right.n, target, right.light, result.batch)
    assert shown.max() > 0
    np.testing.assert_allclose(
        corrected.edit(result.batch, target), mirror_correction.factor(metal) * shown, rtol=1e-5
    )
