"""Arguments of a wrong type from Python: one line that says what was found, and never a trace."""

import decimal
import os

import numpy as np
import pytest
from PIL import Image

import brdfactory as bf

torch = pytest.importorskip("torch", reason="torch is not installed")

NAN = float("nan")
JOB = {"shapes": ["sphere"], "materials": ["green-latex"], "lights": ["city"]}


@pytest.fixture(scope="module")
def picture():
    """A shaded ball, its mask, and the decomposition of both."""
    y, x = np.mgrid[-1:1:64j, -1:1:64j]
    inside = x * x + y * y < 0.6
    shade = np.where(inside, 80 + 90 * np.sqrt(np.clip(0.6 - x * x - y * y, 0, 1)) - 50 * y, 30)
    photo = np.stack([shade, 0.8 * shade, 0.6 * shade], -1).clip(0, 255).astype(np.uint8)
    return photo, inside, bf.decompose(photo, inside, refine=False)


def decompose(picture, **options):
    return bf.decompose(picture[0], picture[1], **{"refine": False} | options)


def nested(picture):
    return picture[0].tolist()


MISTAKES = [
    (lambda p: decompose(p, detail=None), "detail: expected a number from 0 to 1, found None"),
    (lambda p: decompose(p, detail="0.5"), "found '0.5'"),
    (lambda p: decompose(p, detail=True), "found True"),
    (lambda p: decompose(p, exposure="1"), "exposure: .*found '1'"),
    (lambda p: decompose(p, exposure=np.ones(3)), r"found ndarray of shape \(3,\)"),
    (lambda p: decompose(p, exposure=10**400), "found 1000000"),
    (lambda p: decompose(p, refine="no"), "refine: expected True or False, found 'no'"),
    (lambda p: decompose(p, fit_mask="no"), "fit_mask: expected True or False"),
    (lambda p: decompose(p, shape=np.array(["box", "flat"])), "shape: .*found ndarray"),
    (lambda p: decompose(p, weights=None), "weights: expected a file.*found None"),
    (lambda p: decompose(p, device="mps"), "device: expected auto, cpu or cuda, found mps"),
    (lambda p: decompose(p, device=torch.device("meta")), "found meta"),
    (lambda p: decompose(p, device=None), "device: .*found None"),
    (lambda p: bf.decompose(nested(p), p[1]), "photo: expected a file or an array, found list"),
    (lambda p: bf.decompose(Image.fromarray(p[0]), p[1]), "found Image"),
    (lambda p: bf.decompose(torch.from_numpy(p[0]), p[1]), "found Tensor of shape"),
    (lambda p: bf.decompose(p[0], p[1].tolist()), "mask: expected a file or an array"),
    (lambda p: bf.decompose(p[0], True), "mask: .*found True"),
    (lambda p: bf.decompose(p[0], regions=3), "regions: .*found 3"),
    (lambda p: bf.decompose(p[0], regions=np.where(p[1], 1, -1)), "regions: .*found -1"),
    (lambda p: bf.decompose(p[0].astype(float), p[1]), "display values as uint8"),
    (lambda p: bf.decompose("", p[1]), "photo: .*found ''"),
    (lambda p: p[2].paint("brass", brightness="1"), "brightness: .*found '1'"),
    (lambda p: p[2].paint("brass", brightness=None), "brightness: .*found None"),
    (lambda p: p[2].paint(3), "material: .*found 3"),
    (lambda p: p[2].paint(["brass"]), "material: .*found list"),
    (lambda p: p[2].paint(np.array(["a"] * 108)), r"material: expected a label \(108,\)"),
    (lambda p: bf.edit(*p[:2], material=3, refine=False), "material: .*found 3"),
    (lambda p: bf.edit(*p[:2], material=b"brass", refine=False), "material: .*found b'brass'"),
    (lambda p: p[2].relight(None), "relight: light: .*found None"),
    (lambda p: p[2].relight({}), "relight: light: .*found dict"),
    (lambda p: p[2].paint("brass").save(None), "save: .*found None"),
    (lambda p: p[2].paint("brass").save("a\0.png"), "save: "),
    (lambda p: p[2].paint("brass").save("s3://bucket/x.png"), "found a URL"),
    (lambda p: bf.blend("brass", "red-fabric", "0.5"), "share: .*from 0 to 1, found '0.5'"),
    (lambda p: bf.blend("brass", "red-fabric", None), "share: .*found None"),
    (lambda p: bf.blend("brass", "red-fabric", 1j), "share: .*found 1j"),
    (lambda p: bf.material(None), "material: .*found None"),
    (lambda p: bf.light("city", rotation_deg="90"), "number of degrees, found '90'"),
    (lambda p: bf.light("city", rotation_deg=decimal.Decimal(9)), "found Decimal"),
    (lambda p: bf.light(np.ones((64, 128, 3))), r"light: .*found ndarray of shape \(64, 128, 3\)"),
    (lambda p: bf.render(p[2].normals, "city"), "render: light: .*found 'city'"),
    (lambda p: bf.render([[1, 2], [3]], bf.light("city")), "render: normals: .*found list"),
    (lambda p: bf.render(p[2].normals, bf.light("city"), mask="m.png"), "render: mask: "),
    (lambda p: bf.make_mask(nested(p), ["5%,5%", "95%,95%"]), "photo: .*found list"),
    (lambda p: bf.make_mask(p[0], None), "around: expected a list of points, found None"),
    (lambda p: bf.make_mask(p[0], on_object=3), "on_object: expected a list of points"),
    (lambda p: bf.load_job(None), "job: expected a preset's name.*found None"),
    (lambda p: bf.load_job(JOB | {"error": NAN}), "job: error: .*Out of range float"),
    (lambda p: bf.load_job(JOB | {"error": np.float32(NAN)}), "job: error: "),
    (lambda p: bf.load_job(JOB | {"camera": {"fov_deg": NAN}}), "job: camera: "),
    (lambda p: bf.load_job(bf.Job(**JOB, error=NAN)), "job: error: "),
    (lambda p: bf.load_job(bf.Job(**JOB, views=(99,))), "views"),
    (lambda p: bf.load_job(JOB | {"shapes": [b"sphere"]}), "found bytes"),
    (lambda p: bf.load_job(JOB | {"name": "\ud800"}), "job"),
    (lambda p: bf.generate(JOB, "data", workers=1.5), "workers: .*whole number.*found 1.5"),
    (lambda p: bf.generate(JOB, "data", workers="2"), "workers: .*found '2'"),
    (lambda p: bf.generate(JOB, "data", limit=NAN), "limit: .*found nan"),
    (lambda p: bf.generate(JOB, None), "out: expected a folder, found None"),
    (lambda p: bf.generate(JOB, ""), "out: expected a folder, found ''"),
    (lambda p: bf.generate(JOB, "data", lights=3), "lights: .*found 3"),
]


@pytest.mark.parametrize(("call", "words"), MISTAKES)
def test_an_argument_of_another_type_is_refused_in_one_line(picture, call, words, tmp_path):
    before = os.getcwd()
    os.chdir(tmp_path)
    try:
        with pytest.raises(bf.InputError, match=words) as caught:
            call(picture)
    finally:
        os.chdir(before)
    assert len(str(caught.value)) < 600 and "\n" not in str(caught.value)
    assert not any(tmp_path.iterdir())


def test_names_that_are_too_long_for_files_are_unknown_names(picture):
    with pytest.raises(bf.InputError, match=r"weights in a \.safetensors file"):
        decompose(picture, weights="w" * 5000)
    with pytest.raises(bf.InputError, match="a file or a preset"):
        bf.load_job("j" * 5000)


def test_numbers_of_numpy_and_torch_are_numbers(picture):
    plain = decompose(picture, detail=0.25).paint("red-fabric", brightness=1).linear
    for detail, stops in (
        (np.float32(0.25), np.int64(1)),
        (np.array([0.25]), np.array(1)),
        (torch.tensor(0.25), torch.tensor(1)),
    ):
        edited = decompose(picture, detail=detail).paint("red-fabric", brightness=stops)
        np.testing.assert_array_equal(edited.linear, plain)
    expected = bf.light("city", rotation_deg=90)
    np.testing.assert_array_equal(bf.light("city", rotation_deg=np.int8(90)), expected)


def test_lists_and_tensors_are_arrays_where_they_hold_numbers_of_radiance(picture):
    light = bf.light("city")
    expected = picture[2].relight(light, "brass").linear
    for given in (light.tolist(), torch.from_numpy(light)):
        np.testing.assert_array_equal(picture[2].relight(given, "brass").linear, expected)


def test_a_checked_job_is_equal_to_the_one_that_was_given():
    job = bf.load_job(JOB | {"camera": {"size": [8, 16]}, "views": {"random": 2}, "error": 20})
    assert bf.load_job(job) == job
    assert bf.load_job(JOB | {"views": {6, 0}}).views == (0, 6)


def test_radiance_of_whole_numbers_is_taken_if_it_is_small(picture):
    """Only whole numbers far above white are display values in the wrong type."""
    photo = np.where(picture[1][..., None], 2.0, 1.0).repeat(3, -1)
    assert bf.decompose(photo, picture[1], refine=False).photograph.linear
