"""Training and test never share a shape or a material, whatever the order, the names and the
pool.
"""

import json
import re
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from manifests import JOBS, splits
from manifests.reading import read
from manifests.schema import Job

PAPER = {"car": 130, "chair": 50, "sofa": 50, "monitor": 50}


def paper_shapes(hash_of):
    return [
        (f"{family}:{k}", family, hash_of(f"{family}:{k}"))
        for family, count in PAPER.items()
        for k in range(count)
    ]


def hash_of(name):
    import hashlib

    return hashlib.sha256(name.encode()).hexdigest()


def test_the_papers_counts_hold():
    roles = splits.shape_roles(paper_shapes(hash_of), "paper")
    counts = Counter((name.split(":")[0], role) for name, role in roles.items())
    assert counts["car", "pretrain"] == 80
    assert all(
        counts[family, "finetune"] == 40 and counts[family, "test"] == 10 for family in PAPER
    )
    assert sum(counts.values()) == 280


def test_mesh_files_get_the_same_counts_by_the_rank_of_their_hash():
    shapes = [(f"models/{k}", "chair", hash_of(str(k))) for k in range(50)]
    assert Counter(splits.shape_roles(shapes, "paper").values()) == {"finetune": 40, "test": 10}


def test_multi_material_chairs_are_eighty_and_twenty():
    roles = splits.shape_roles(
        [(f"chair:{k}", "chair", hash_of(str(k))) for k in range(100)], "multi-material"
    )
    assert Counter(roles.values()) == {"finetune": 80, "test": 20}


@pytest.mark.parametrize(("job", "count"), [("test", 40), ("multi-material", 20)])
def test_the_test_side_of_a_preset_has_no_seed_that_the_committed_weights_were_trained_on(
    job, count
):
    def numbered(name):
        texts = json.loads((JOBS / f"{name}.json").read_text())["shapes"]
        ends = [re.fullmatch(r"(\w+):(\d+)-(\d+)", text).groups() for text in texts]
        return {f"{family}:{k}" for family, a, b in ends for k in range(int(a), int(b) + 1)}

    rule = json.loads((JOBS / f"{job}.json").read_text())["split"]
    shapes = [(name, name.partition(":")[0], hash_of(name)) for name in sorted(numbered(job))]
    roles = splits.shape_roles(shapes, rule)
    tested = {name for name, role in roles.items() if role == "test"}
    assert len(tested) == count
    # cars 120–129 lie behind the hundred of the job geometry as well
    assert not tested & numbered("geometry")
    for name, family, hash_ in shapes:
        assert splits.numbered_role(name, rule) == roles[name]
        assert splits.role_of(name, family, hash_, rule) == roles[name]


def test_further_seeds_are_of_families_alone_and_mesh_files_keep_their_ranks():
    files = [(f"file{k}", "chair", hash_of(str(k))) for k in range(130)]
    roles = splits.shape_roles(files, "paper")
    by_rank = sorted(files, key=lambda each: each[2])
    assert {roles[name] for name, _, _ in by_rank[40:50]} == {"test"}
    assert "train" in {roles[name] for name, _, _ in by_rank[110:120]}
    assert {splits.numbered_role(f"chair:{k}", "paper") for k in range(110, 120)} == {"test"}


def test_general_holds_families_out_and_takes_own_families_as_hash_does():
    shapes = [
        (n, n.split(":")[0], hash_of(n)) for n in (f"{f}:{k}" for f in PAPER for k in range(130))
    ]
    assert splits.shape_roles(shapes, "general") == splits.shape_roles(shapes, "hash")
    general = [
        (f"{f}:{k}", f, hash_of(f"{f}:{k}")) for f in ("knot", "tool", "toy") for k in range(9)
    ]
    roles = splits.shape_roles(general, "general")
    assert {role for name, role in roles.items() if name.startswith("toy")} == {"train"}
    assert {role for name, role in roles.items() if not name.startswith("toy")} == {"test"}


@pytest.mark.parametrize("rule", ["hash", "paper", "multi-material", "general"])
@given(
    names=st.lists(
        st.sampled_from([f"chair:{k}" for k in range(60)] + [f"file{k}" for k in range(40)]),
        unique=True,
    ),
    data=st.data(),
)
def test_twins_stand_on_one_side_and_order_does_not_matter(rule, names, data):
    # ten meshes under many names
    hashes = {name: hash_of(str(data.draw(st.integers(0, 9)))) for name in names}
    shapes = [(name, "chair", hashes[name]) for name in names]
    roles = splits.shape_roles(shapes, rule)
    assert splits.shape_roles(data.draw(st.permutations(shapes)), rule) == roles
    sides = {}
    for name in names:
        assert (
            sides.setdefault(hashes[name], splits.SIDES[roles[name]]) == splits.SIDES[roles[name]]
        )


def test_by_hash_a_shapes_side_does_not_depend_on_its_company():
    shapes = [(f"file{k}", "chair", hash_of(str(k))) for k in range(200)]
    together = splits.shape_roles(shapes, "hash")
    assert all(
        splits.shape_roles([shape], "hash")[shape[0]] == together[shape[0]] for shape in shapes
    )
    # a fifth of 200: 40 ± 3.5 σ of a binomial
    assert 20 <= Counter(together.values())["test"] <= 60


def test_of_material_twins_the_test_side_wins():
    sides = splits.material_sides(
        [
            ("brass", "test", "a" * 64),
            ("brass-copy", "train", "a" * 64),
            ("felt", "train", "b" * 64),
        ]
    )
    assert sides == {"brass": "test", "brass-copy": "test", "felt": "train"}


def test_sixty_training_materials_are_chosen_whatever_their_order():
    names = [f"material-{k}" for k in range(80)]
    assert splits.paper_training(names) == splits.paper_training(names[::-1])
    assert len(splits.paper_training(names)) == 60


def test_a_record_is_mixed_when_shape_and_material_disagree():
    assert splits.split_of("train", ["train", "train"]) == "train"
    assert splits.split_of("test", ["test"]) == "test"
    assert (
        splits.split_of("train", ["train", "test"]) == splits.split_of("test", ["train"]) == "mixed"
    )


@pytest.mark.parametrize("rule", ["hash", "paper", "multi-material", "general"])
def test_families_for_testing_only_are_never_trained_on(rule):
    names = [f"{family}:{k}" for family in splits.rules()["test_only"] for k in (0, 7, 10**12)]
    shapes = [(name, name.split(":")[0], hash_of(name)) for name in names]
    assert set(splits.shape_roles(shapes, rule).values()) == {"test"}
    assert {splits.numbered_role(name, rule) for name in names} == {"test"}
    assert {splits.role_of(*shape, rule) for shape in shapes} == {"test"}


def test_a_users_own_mesh_of_such_a_category_may_be_trained_on():
    shapes = [(f"my/{k}", "shoe", hash_of(str(k))) for k in range(60)]
    assert set(splits.shape_roles(shapes, "hash").values()) == {"train", "test"}


def test_no_preset_but_the_second_test_side_names_families_for_testing_only():
    named = {
        path.stem
        for path in JOBS.glob("*.json")
        for shape in read(path, Job).shapes
        if shape.partition(":")[0] in splits.rules()["test_only"]
    }
    assert named == {"ladder-second-test"}
