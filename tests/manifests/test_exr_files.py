"""OpenEXR files on both sides of the contract: whole or not there at all, and nothing on the
terminal but the one line.
"""

import numpy as np
import pytest

from manifests import exr
from manifests.errors import InputError


def test_a_truncated_file_is_one_problem_and_the_library_says_nothing_beside_it(tmp_path, capfd):
    rng = np.random.default_rng(0)
    exr.write(
        tmp_path / "whole.exr", {name: rng.random((64, 64), dtype=np.float32) for name in "RGB"}
    )
    data = (tmp_path / "whole.exr").read_bytes()
    (tmp_path / "cut.exr").write_bytes(data[: len(data) * 2 // 3])
    with pytest.raises(
        InputError,
        match=r"cut\.exr: expected a whole OpenEXR file, found .* \(render or copy it again",
    ):
        exr.read(tmp_path / "cut.exr")
    print("heard")
    assert capfd.readouterr() == ("heard\n", "")
