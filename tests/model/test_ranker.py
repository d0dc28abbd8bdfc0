"""Laws of the network: what it shares, what it ignores, and that its score orders as the product of its probabilities."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from model.batches import EncodedRelease, encode_release, model_input
from model.inputs import InputReader, ReleaseInputs, read_inputs
from model.pointnet2 import SetAbstraction
from model.ranker import ModelInput, Prediction, Ranker, pose9
from model.settings import RankerSettings, Variant
from tables.poses import matrix_of

_CPU = torch.device("cpu")
# Sums of a few hundred float32 terms of size 1, in an order that the matrix library chooses by batch size.
_FLOAT32 = {"rtol": 1e-4, "atol": 1e-4}


@pytest.fixture(scope="module")
def inputs(small_release: Path) -> ReleaseInputs:
    return read_inputs(InputReader(small_release))


@pytest.fixture(scope="module")
def release(inputs: ReleaseInputs, tiny: RankerSettings) -> EncodedRelease:
    return encode_release(inputs, tiny, Variant.FULL)


def test_encoding_a_cloud_once_equals_encoding_it_for_every_candidate(release: EncodedRelease, tiny: RankerSettings) -> None:
    ranker = Ranker(tiny, Variant.FULL, seed=0).eval()
    x = model_input(release, np.arange(8), _CPU)
    once = ranker(x)
    for k in range(len(x.group)):
        g = int(x.group[k])
        clouds = (getattr(x, name)[g : g + 1] for name in ("points_m", "point_types", "neighbours_1", "neighbours_2", "target_pose"))
        alone = ranker(ModelInput(*clouds, x.grasp_pose[k : k + 1], x.object_relative_pose[k : k + 1], torch.zeros(1, dtype=torch.long)))
        torch.testing.assert_close(alone.plan_logit, once.plan_logit[k : k + 1], **_FLOAT32)
        torch.testing.assert_close(alone.exec_logit, once.exec_logit[k : k + 1], **_FLOAT32)


def test_the_grasp_branch_may_read_the_hand_at_the_place(inputs: ReleaseInputs, release: EncodedRelease, tiny: RankerSettings) -> None:
    """Reference: the pose that `candidate_geometry` starts from, the object moved to its target with the hand on it."""
    at_place = encode_release(inputs, replace(tiny, is_grasp_at_place=True), Variant.FULL)
    k = len(inputs.candidate_ids) // 2
    group = inputs.candidate_group[k]
    T_base_object = inputs.clouds[inputs.group_scene[group]].T_base_object
    T_base_hand = inputs.T_base_target[group] @ np.linalg.inv(T_base_object) @ inputs.T_base_grasp[k]
    np.testing.assert_allclose(at_place.grasp_pose[k].numpy(), pose9(T_base_hand[None])[0], atol=1e-6)
    assert torch.equal(at_place.object_relative_pose, release.object_relative_pose)
    assert not torch.equal(at_place.grasp_pose, release.grasp_pose)


def test_scene_feature_does_not_depend_on_the_order_of_points(release: EncodedRelease, tiny: RankerSettings) -> None:
    """Centres stay, the other points and every list of neighbours are shuffled."""
    backbone = Ranker(tiny, Variant.FULL, seed=0).scene.eval()
    x = model_input(release, np.arange(3), _CPU)
    generator = torch.Generator().manual_seed(0)
    n, s = tiny.n_points, tiny.n_centres_1
    order = torch.cat([torch.arange(s), s + torch.randperm(n - s, generator=generator)])
    place = torch.empty(n, dtype=torch.long).scatter_(0, order, torch.arange(n))
    within = torch.randperm(tiny.n_neighbours_1, generator=generator)
    shuffled = backbone(x.points_m[:, order], x.point_types[:, order], place[x.neighbours_1][..., within], x.neighbours_2.flip(-1))
    torch.testing.assert_close(shuffled, backbone(x.points_m, x.point_types, x.neighbours_1, x.neighbours_2), **_FLOAT32)


def test_split_first_layer_equals_the_layer_on_each_neighbour() -> None:
    """Reference: gather first, then one linear layer on (offset / radius, feature)."""
    torch.manual_seed(0)
    level = SetAbstraction(n_features=5, widths=(8, 16), radius_m=0.1)
    points, features = torch.rand(2, 20, 3), torch.rand(2, 20, 5)
    neighbours = torch.randint(20, (2, 6, 4))
    rows = torch.arange(2)[:, None, None]
    offset = (points[rows, neighbours] - points[:, :6, None]) / 0.1
    each = level.first(torch.cat([offset, features[rows, neighbours]], -1))
    expected = level.rest(torch.relu(level.norm(each))).amax(-2)
    torch.testing.assert_close(level(points, features, neighbours), expected, **_FLOAT32)


@given(quaternion=arrays(np.float64, 4, elements=st.floats(-1, 1)).filter(lambda q: np.linalg.norm(q) > 1e-3))
def test_rotation_survives_the_six_numbers(quaternion: np.ndarray) -> None:
    """Gram-Schmidt on the two columns gives the rotation back; float32 in between."""
    T = matrix_of(np.concatenate([[0.1, -0.2, 0.3], quaternion]))
    pose = pose9(T).astype(np.float64)
    x = pose[3:6] / np.linalg.norm(pose[3:6])
    y = pose[6:] - (x @ pose[6:]) * x
    y /= np.linalg.norm(y)
    np.testing.assert_allclose(np.column_stack([x, y, np.cross(x, y)]), T[:3, :3], atol=1e-6)
    np.testing.assert_allclose(pose[:3], T[:3, 3], atol=1e-7)


@given(logits=arrays(np.float64, st.tuples(st.integers(2, 30), st.just(2)), elements=st.floats(-12, 12)))
def test_score_orders_as_the_product_of_the_probabilities(logits: np.ndarray) -> None:
    plan, execution = torch.from_numpy(logits).T
    score = Prediction(plan, execution).score.numpy()
    product = 1.0 / (1.0 + np.exp(-logits[:, 0])) / (1.0 + np.exp(-logits[:, 1]))
    above = product[:, None] > product[None, :] * (1 + 1e-9)  # nearer ones may tie in float64
    assert np.all((score[:, None] > score[None, :])[above])
    np.testing.assert_allclose(np.exp(score), product, rtol=1e-9)


def test_score_is_finite_where_probabilities_underflow() -> None:
    score = Prediction(torch.tensor([-1e4, 1e4, -1e4]), torch.tensor([-1e4, 1e4, 1e4])).score
    assert score.tolist() == [-2e4, 0.0, -1e4]


def test_without_object_relative_pose_the_pose_does_not_matter(release: EncodedRelease, tiny: RankerSettings) -> None:
    x = model_input(release, np.arange(4), _CPU)
    moved = replace(x, object_relative_pose=x.object_relative_pose + 0.3)
    for variant, matters in ((Variant.FULL, True), (Variant.NO_OBJECT_RELATIVE, False)):
        ranker = Ranker(tiny, variant, seed=0).eval()
        assert torch.equal(ranker(x).score, ranker(moved).score) is not matters


@pytest.mark.parametrize("name", ["points_m", "point_types", "target_pose", "grasp_pose", "object_relative_pose"])
def test_each_of_the_five_inputs_matters(release: EncodedRelease, tiny: RankerSettings, name: str) -> None:
    ranker = Ranker(tiny, Variant.FULL, seed=0).eval()
    x = model_input(release, np.arange(4), _CPU)
    value = getattr(x, name)
    changed = (value + 1) % 4 if name == "point_types" else value + 0.05 * torch.arange(value.numel()).reshape(value.shape).sin()
    assert not torch.equal(ranker(x).score, ranker(replace(x, **{name: changed})).score)


def test_direct_variant_has_one_probability(release: EncodedRelease, tiny: RankerSettings) -> None:
    prediction = Ranker(tiny, Variant.DIRECT, seed=0).eval()(model_input(release, np.arange(2), _CPU))
    assert prediction.plan_logit is None
    assert not prediction.log_p_plan.any()
    assert torch.equal(prediction.score, prediction.log_p_exec)


def test_feature_widths_are_those_of_the_architecture(release: EncodedRelease, tiny: RankerSettings) -> None:
    ranker = Ranker(tiny, Variant.FULL, seed=0)
    x = model_input(release, np.arange(2), _CPU)
    n = len(x.group)
    assert ranker.scene(x.points_m, x.point_types, x.neighbours_1, x.neighbours_2).shape == (2, 512)
    assert ranker.grasp(x.grasp_pose).shape == (n, 256)
    assert ranker.relative(x.object_relative_pose).shape == (n, 128)
    assert ranker.target(x.target_pose).shape == (2, 128)
    assert [layer.in_features for layer in (ranker.fusion_1.linear[0], ranker.fusion_2.linear[0], ranker.exec_head)] == [1024, 512, 256]


def test_first_weights_depend_on_seed_and_name_alone(tiny: RankerSettings) -> None:
    full, again, other, direct = (
        Ranker(tiny, v, s).state_dict() for v, s in ((Variant.FULL, 1), (Variant.FULL, 1), (Variant.FULL, 2), (Variant.DIRECT, 1))
    )
    assert all(torch.equal(full[name], again[name]) for name in full)
    assert all(torch.equal(full[name], direct[name]) for name in direct)
    drawn = [name for name in full if "norm" not in name]
    assert not any(torch.equal(full[name], other[name]) for name in drawn)
