"""Which of several models counts, where each is grown from another first pair."""

from types import SimpleNamespace

import pytest

from tisfm.reconstruction import growing

MATCHES = 1000


class Model:
    """What is grown from a first pair: number of views, score, triangulated observations."""

    def __init__(self):
        self.views, self.explained, self.observations = 0, 0.0, 0

    def num_reg_images(self):
        return self.views

    def compute_num_observations(self):
        return self.observations


@pytest.fixture
def chosen(monkeypatch):
    """Return a function that grows models from first pairs, and gives what `_one` returns."""

    def choose(models):
        grown = []

        def grow(mapper, model, options, left):
            model.views, model.explained, model.observations = models[len(grown)]
            grown.append(model)

        def starts(mapper, options, left, begun):
            for k in range(len(models)):
                yield 2 * k + 1, 2 * k + 2, None

        monkeypatch.setattr(growing, "_grow", grow)
        monkeypatch.setattr(growing, "pycolmap", lambda: SimpleNamespace(Reconstruction=Model))
        mapper = SimpleNamespace(
            begin_reconstruction=lambda model: None,
            register_initial_image_pair=lambda *arguments: None,
            triangulate_image=lambda *arguments: None,
            end_reconstruction=lambda discard: None,
        )
        score = SimpleNamespace(
            score=lambda model: model.explained * MATCHES, matches=lambda views: MATCHES
        )
        options = SimpleNamespace(mapper=None, triangulation=None)
        first_pairs = SimpleNamespace(starts=starts)
        found = growing._one(mapper, score, options, first_pairs, set(range(1, 11)))
        return (None if found is None else grown.index(found)), len(grown)

    return choose


@pytest.mark.parametrize(
    ("scores", "best", "count"),
    [
        ((0.83, 0.99, 0.99), 1, 2),  # a bent model explains so much
        ((0.98, 0.99), 0, 1),
        ((0.55, 0.551, 0.9), 1, 2),  # noisy frames: two first pairs lead to the same
        ((0.83, 0.55, 0.83), 0, 3),
        ((0.3, 0.83, 0.5, 0.99), 1, 3),  # no more than three are grown
        ((0.83,), 0, 1),
        ((), None, 0),
    ],
)
def test_the_best_score_counts(chosen, scores, best, count):
    assert chosen([(10, score, 100) for score in scores]) == (best, count)


def test_triangulated_observations_do_not_count(chosen):
    assert chosen([(10, 0.5, 4000), (10, 0.7, 2000), (10, 0.4, 5000)]) == (1, 3)


def test_a_model_of_two_views_does_not_count(chosen):
    assert chosen([(2, 0.99, 100), (3, 0.3, 100)]) == (1, 2)
    assert chosen([(2, 0.99, 100)]) == (None, 1)
