"""One formula, two libraries: what runs in numpy runs in torch, with the same values and with
gradients.
"""

import ast
import subprocess
import sys

import numpy as np
import pytest

from shaders import arrays, dsbrdf, spline, tone

SINCE_NUMPY_2 = {
    "concat",
    "acos",
    "asin",
    "atan",
    "atan2",
    "pow",
    "astype",
    "permute_dims",
    "matrix_transpose",
    "vecdot",
    "unstack",
}


def test_numpy_arrays_and_plain_numbers_run_in_numpy():
    assert arrays.namespace(np.zeros(3), 1.0) is np
    assert arrays.namespace() is np


def test_one_tensor_among_the_arguments_moves_the_formula_to_torch():
    torch = pytest.importorskip("torch")
    assert arrays.namespace(np.zeros(3), torch.zeros(3)) is torch


def test_shaders_never_import_torch_themselves():
    code = (
        "import sys, numpy as np; from shaders import arrays, dsbrdf, envmap, frames, spline, tone;"
        "dsbrdf.evaluate(np.ones(108), np.ones(2), np.zeros(2)); sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_constants_take_the_dtype_of_the_array_they_meet():
    assert arrays.like([1, 2], np.zeros(3, dtype=np.float32)).dtype == np.float32
    torch = pytest.importorskip("torch")
    assert arrays.like([1, 2], torch.zeros(3, dtype=torch.float64)).dtype == torch.float64


def test_every_name_taken_from_either_library_exists_in_both_and_in_numpy_1_and_2(root):
    torch = pytest.importorskip("torch")
    missing = []
    for path in sorted((root / "shaders").glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                library, name = node.value.id, node.attr
                known = {
                    "xp": hasattr(np, name) and hasattr(torch, name),
                    "np": name not in SINCE_NUMPY_2,
                }.get(library, True)
                if not known:
                    missing.append(f"{path.name}:{node.lineno}: {library}.{name}")
    assert not missing


@pytest.fixture
def half_space(rng):
    """Random cos_h (40,) in (−1, 1) and θ_d (40,) in [0, π/2]."""
    return rng.uniform(-1, 1, 40), rng.uniform(0, np.pi / 2, 40)


def formulas(rng, half_space):
    """(name, function of one array, that array) for every formula that both libraries must
    share.
    """
    cos_h, theta_d = half_space
    w = rng.normal(size=(40, 3))
    w /= np.linalg.norm(w, axis=-1, keepdims=True)
    m = rng.uniform(0.1, 2.0, 108)
    return [
        ("spline basis", spline.basis, theta_d),
        ("label", lambda m: dsbrdf.evaluate(m, arrays.like(cos_h, m), arrays.like(theta_d, m)), m),
        (
            "half vector",
            lambda w: dsbrdf.half_angles(w, arrays.like([0.0, 0.0, 1.0], w) + 0 * w)[0],
            w,
        ),
        (
            "difference angle",
            lambda w: dsbrdf.half_angles(w, arrays.like([0.0, 0.0, 1.0], w) + 0 * w)[1],
            w,
        ),
        ("sRGB curve", tone.srgb, rng.uniform(-0.2, 1.2, 40)),
    ]


def test_torch_gives_numpys_values_and_finite_gradients(rng, half_space):
    torch = pytest.importorskip("torch")
    for name, formula, x in formulas(rng, half_space):
        tensor = torch.tensor(x, dtype=torch.float64, requires_grad=True)
        result = formula(tensor)
        # the same double-precision operations in another order of summation: a few units of 2e-16
        np.testing.assert_allclose(
            result.detach().numpy(), formula(x), rtol=1e-12, atol=1e-14, err_msg=name
        )
        result.sum().backward()
        assert torch.isfinite(tensor.grad).all(), name
