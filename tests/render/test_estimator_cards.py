"""Every estimator, and each rule that saves light paths, says what it is, its bias and its cost."""

import re
from typing import get_args

import pytest

from factory.render import estimators, self_shading
from factory.render.estimators import (
    adaptive_sampling,
    closed_form,
    denoised,
    path_tracing,
    ratio,
    shadow_rays,
)
from manifests.schema import Estimator

CHOSEN = (path_tracing, denoised, ratio, closed_form, shadow_rays)


@pytest.mark.parametrize("module", [*CHOSEN, adaptive_sampling, self_shading])
def test_a_card_says_what_it_is_its_bias_its_cost_and_where_it_fails(module):
    assert {"what", "bias", "cost", "fails"} <= set(re.findall(r"^(\w+)  +", module.__doc__, re.M))
    name = module.__name__.rsplit(".", 1)[1]
    assert re.search(rf"^{name}  ?", estimators.__doc__, re.M), "not listed"


def test_there_is_a_card_for_each_estimator_that_a_record_may_name():
    assert {module.NAME for module in CHOSEN} == set(get_args(Estimator))
