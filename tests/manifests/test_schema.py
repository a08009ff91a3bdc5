"""What the contract's types let in, and how they say no: one line, with the key's path and the
closest name.
"""

import json
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manifests import publish
from manifests.errors import InputError
from manifests.reading import decode, read
from manifests.schema import Dataset, Draw, Failure, Job, Record

JOBS = sorted((Path(publish.__file__).parent / "jobs").glob("*.json"))
GOOD = {"shapes": ["sphere"], "materials": ["brass"], "lights": ["city"]}


def refused(value, type_=Job):
    data = value if isinstance(value, bytes) else json.dumps(value).encode()
    with pytest.raises(InputError) as caught:
        decode(data, type_, "job.json")
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sampels": 3}, "job.json: expected a known key, found 'sampels' (did you mean samples"),
        (
            {"camera": {"sise": [3, 4]}},
            "job.json: camera: expected a known key, found 'sise' (did you mean size?",
        ),
        (
            {"views": {"randon": 5}},
            "job.json: views: expected a known key, found 'randon' (did you mean random?",
        ),
        ({"samples": "many"}, 'job.json: samples: expected int, found "many"'),
        ({"samples": 0}, "job.json: samples: expected int >= 1, found 0"),
        ({"views": ["front"]}, 'job.json: views[0]: expected int, found "front"'),
        ({"views": [24]}, "job.json: views[0]: expected int <= 23, found 24"),
        (
            {"tiers": ["dirct"]},
            (
                "job.json: tiers[0]: expected one of direct, shadow, full, found 'dirct' (did you"
                " mean direct?"
            ),
        ),
        ({"version": 2}, "job.json: version: expected one of 1, found 2"),
        ({"shapes": []}, "job.json: shapes: expected array of length >= 1, found []"),
        ({"shapes": "chair:0"}, 'job.json: shapes: expected array, found "chair:0"'),
        ({"camera": {"size": [2, 64]}}, "job.json: camera.size[0]: expected int >= 4, found 2"),
        ({"seed": -1}, "job.json: seed: expected int >= 0, found -1"),
        ({"split": "papre"}, "did you mean paper?"),
    ],
)
def test_a_job_that_is_wrong_is_refused_with_the_place_and_the_remedy(change, message):
    assert message in refused({**GOOD, **change})


@pytest.mark.parametrize(
    "data",
    [b"", b"{", b"[]", b"\xff\xfe", b"[" * 200_000, b'{"shapes": [1,]}', b"NaN", b'{"shapes"'],
)
def test_what_is_no_json_object_is_refused_in_one_line(data):
    assert refused(data).startswith("job.json: ")


def test_a_missing_key_is_named():
    assert "expected the key 'materials'" in refused({"shapes": ["a"], "lights": ["b"]})


def test_records_of_another_make_are_refused():
    assert "expected a known key, found 'flavour'" in refused(
        {"id": "0" * 24, "flavour": 1}, Record
    )
    assert "expected the key 'id'" in refused({}, Record)


@given(
    st.recursive(
        st.none()
        | st.booleans()
        | st.integers()
        | st.floats(allow_nan=False)
        | st.text(max_size=8),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(
                st.sampled_from(["shapes", "camera", "views", "size", "seed", "random", "x"]),
                inner,
                max_size=4,
            )
        ),
        max_leaves=8,
    )
)
def test_whatever_json_is_given_a_job_comes_out_or_one_line(value):
    for type_ in (Job, Dataset, Failure):
        try:
            decode(json.dumps(value).encode(), type_, "file")
        except InputError as problem:
            assert "\n" not in str(problem)


def test_a_draw_and_a_list_both_read_as_views():
    assert decode(json.dumps({**GOOD, "views": {"random": 5}}).encode(), Job, "x").views == Draw(
        random=5
    )
    assert decode(json.dumps({**GOOD, "views": [3, 1]}).encode(), Job, "x").views == (3, 1)


def test_a_missing_or_huge_file_is_refused_before_it_is_read(tmp_path):
    (tmp_path / "demo.json").write_text("{}")
    with pytest.raises(InputError, match=r"demo\.json"):
        read(tmp_path / "dmeo.json", Job)
    with pytest.raises(InputError, match="a folder"):
        read(tmp_path, Job)
    with open(tmp_path / "huge.json", "wb") as file:
        file.truncate(10 << 20)
    with pytest.raises(InputError, match=r"at most 1\.0 MiB"):
        read(tmp_path / "huge.json", Job, 1 << 20)


@pytest.mark.parametrize("name", sorted(publish.TYPES))
def test_the_published_json_schema_is_that_of_the_types(name):
    """`python -m manifests.publish` writes them."""
    assert (publish.FOLDER / f"{name}.schema.json").read_text(
        encoding="utf-8"
    ) == publish.documents()[f"{name}.schema.json"]


@pytest.mark.parametrize("path", JOBS, ids=lambda path: path.stem)
def test_every_preset_fits_types_and_published_schema(path):
    jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is a development extra")
    read(path, Job)
    jsonschema.validate(
        json.loads(path.read_text()), json.loads((publish.FOLDER / "job.schema.json").read_text())
    )


def test_the_presets_that_the_program_promises_are_there():
    assert {"demo", "agreement", "pretrain", "finetune", "multi-material"} <= {
        path.stem for path in JOBS
    }


def test_a_record_written_and_read_is_the_same(a_record):
    assert msgspec.json.decode(msgspec.json.encode(a_record("ab" * 12)), type=Record) == a_record(
        "ab" * 12
    )
