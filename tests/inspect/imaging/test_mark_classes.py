"""Kinds of marks: weights that add up, poses that are missing, and names and weights in another renderer's light."""

import numpy as np
import pytest

from anisoscope.imaging.mark_classes import (
    CONTINUED,
    SIDES,
    TEXTURE,
    UNKNOWN,
    MarkSigns,
    group_numbers,
    kinds_of_groups,
    known_classes,
)
from anisoscope.parameters.geometry import Pose
from marks import LOOKS, NAMES, judged, largest, named

UPRIGHT = known_classes()[False]
SHAPE = (40, 60)


def poses(*pairs):
    return tuple(Pose(*pair) for pair in pairs)


def signs_of(off, over):
    one = over.astype(float)
    return MarkSigns.of(off, one, 0.2 * one, poses((0.0, 0.0), (90.0, 0.0), (180.0, 0.0)))


def test_the_file_has_the_kinds_that_the_evidence_draws():
    for classes in known_classes().values():
        assert classes.names == NAMES
        assert 0.2 <= classes.temper <= 1.0
        assert np.isfinite(classes.means[:, CONTINUED]).all()
        assert all(np.linalg.eigvalsh(one).min() > 0.0 for one in classes.covariances)
    assert np.isfinite(known_classes()[True].means).all()


def test_a_typical_mark_is_of_its_kind_and_weights_add_up():
    rows = UPRIGHT.weights(UPRIGHT.means)
    assert rows.sum(axis=1) == pytest.approx(1.0)
    assert list(rows.argmax(axis=1)) == list(range(len(NAMES)))


def test_a_mark_like_none_of_the_kinds_is_unknown():
    strange = UPRIGHT.means.mean(axis=0) + 20.0
    assert (*NAMES, UNKNOWN)[int(UPRIGHT.weights(strange[None])[0].argmax())] == UNKNOWN


def test_poses_that_are_missing_are_left_out(rng):
    """Without a pose at 90° the weights are those of the others; with none at all, of the form."""
    numbers = UPRIGHT.means.copy()
    numbers[:, 5] = np.nan
    rows = UPRIGHT.weights(numbers)
    assert np.isfinite(rows).all()
    assert rows.sum(axis=1) == pytest.approx(1.0)


def test_a_side_is_the_mean_over_its_poses_and_270_degrees_is_a_side_like_90():
    cells = np.arange(5.0)[:, None, None] * np.ones((5, 2, 2))
    found = MarkSigns.of(
        cells, np.zeros((2, 2)), np.zeros((2, 2)),
        poses((0.0, 0.0), (90.0, 0.0), (270.0, 0.0), (90.0, 5.0), (85.0, 10.0)),
    )  # fmt: skip
    means = {side: found.off[k, 0, 0] for k, side in enumerate(SIDES)}
    assert means[0.0, 0] == 0.0
    assert means[90.0, 0] == 1.5
    assert means[90.0, 1] == 3.5
    assert np.isnan(means[180.0, 0])
    assert not found.tilted


def test_a_row_of_nicks_across_the_ridges_is_continued_and_one_mark_is_not():
    over = np.zeros(SHAPE, dtype=bool)
    for k in range(5):
        over[4 + 2 * k, 4 + 5 * k : 6 + 5 * k] = True
    score = np.where(over, 2.0, 0.1)
    off = np.where(over, -0.3, 0.0)[None] * np.ones((3, 1, 1))
    labels, weights = kinds_of_groups(over, score, 1.0, signs_of(off, over))
    numbers = group_numbers(labels, 6, score, 1.0, signs_of(off, over))
    assert numbers.shape == (5, len(UPRIGHT.means[0]))
    assert list(numbers[:, CONTINUED]) == [0.5, 1.0, 1.0, 1.0, 0.5]
    assert max(weights[2], key=weights[2].get) == "scratch"
    alone = over & (np.arange(SHAPE[1]) < 8)
    labels, _ = kinds_of_groups(alone, score, 1.0, signs_of(off, alone))
    assert group_numbers(labels, 2, score, 1.0, signs_of(off, alone))[0, CONTINUED] == 0.0


def test_neighbours_among_many_marks_continue_nothing(rng):
    over = rng.random((60, 60)) < 0.05
    score, off = np.where(over, 2.0, 0.1), np.zeros((3, 60, 60))
    labels, weights = kinds_of_groups(over, score, 1.0, signs_of(off, over))
    assert np.isnan(
        group_numbers(labels, labels.max() + 1, score, 1.0, signs_of(off, over))[:, CONTINUED]
    ).all()
    assert sum(next(filter(None, weights)).values()) == pytest.approx(1.0)


def test_single_cells_have_no_kind():
    over = np.zeros(SHAPE, dtype=bool)
    over[3, 3] = over[10, 10] = over[10, 11] = True
    off = np.zeros((3, *SHAPE))
    _, weights = kinds_of_groups(over, np.where(over, 2.0, 0.1), 1.0, signs_of(off, over))
    assert sorted(map(bool, weights)) == [False, True]


@pytest.mark.statistics
def test_marks_in_traced_light_get_their_names_and_the_weights_hold():
    """24 sheets of two designs by the path tracer: docs/evidence/marks.md has the table by kind."""
    sheets = [judged(number) for number in range(24)]
    for look, least in (("upright", 0.7), ("tilted", 0.8)):
        classes, hits, stated = known_classes()[look == "tilted"], [], []
        for sheet in sheets:
            for one, row in largest(named(classes, sheet.get(look, []))):
                if NAMES[one.kind] != TEXTURE:
                    hits.append(int(row.argmax()) == one.kind)
                    stated.append(float(row.max()))
        u = np.sqrt(0.25 / len(hits))
        assert np.mean(hits) > least - 2.0 * u
        assert abs(np.mean(hits) - np.mean(stated)) < 3.0 * u
    assert set(LOOKS) == {"upright", "tilted"}
