"""A model is asked for one grasp by id, and says what it has where it has it not."""

from __future__ import annotations

import dataclasses

import pytest

from objects.errors import ObjectError, UnknownGraspError
from tests.builders import box_model


def test_a_grasp_is_found_by_its_id_wherever_it_stands() -> None:
    model = box_model()
    turned = dataclasses.replace(model, grasps=model.grasps[::-1])
    for some in (model, turned):
        assert [some.grasp(k).grasp_id for k in range(len(model.grasps))] == list(range(len(model.grasps)))
        assert all(some.grasp(pool.grasp_id) is pool for pool in some.grasps)


def test_an_unknown_grasp_is_refused_with_object_id_and_the_ids_there_are() -> None:
    model = dataclasses.replace(box_model(object_id="crate"), grasps=box_model().grasps[3:6])
    with pytest.raises(UnknownGraspError) as failure:
        model.grasp(64)
    assert str(failure.value) == "crate: grasp 64 is not in the pool, must be one of [3, 4, 5]"
    assert isinstance(failure.value, ObjectError)
    assert isinstance(failure.value, LookupError)
    with pytest.raises(UnknownGraspError, match=r"crate: grasp 0 .*\[\]"):
        dataclasses.replace(model, grasps=()).grasp(0)
