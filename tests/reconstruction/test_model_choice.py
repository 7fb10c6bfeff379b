"""The choice between models grown from different first pairs."""

from types import SimpleNamespace

import pytest

from tisfm.reconstruction.mapping import incremental as growing

MATCHES = 1000


class Model:
    """A model: number of views, score, triangulated observations, and score of its worst view."""

    def __init__(self):
        self.views, self.explained, self.observations, self.least_view = 0, 0.0, 0, 0.0

    def num_reg_images(self):
        return self.views

    def compute_num_observations(self):
        return self.observations


@pytest.fixture
def chosen(monkeypatch):
    """Return a function that runs `_build_model` with given models, and returns its choice."""

    def choose(models):
        grown = []

        def grow(mapper, model, options, left):
            model.views, model.explained, model.observations, model.least_view = models[len(grown)]
            grown.append(model)

        def starts(mapper, options, left, begun):
            for k in range(len(models)):
                yield 2 * k + 1, 2 * k + 2, None

        monkeypatch.setattr(growing, "_add_views", grow)
        monkeypatch.setattr(growing, "pycolmap", lambda: SimpleNamespace(Reconstruction=Model))
        mapper = SimpleNamespace(
            begin_reconstruction=lambda model: None,
            register_initial_image_pair=lambda *arguments: None,
            triangulate_image=lambda *arguments: None,
            end_reconstruction=lambda discard: None,
        )
        score = SimpleNamespace(
            score=lambda model: model.explained * MATCHES,
            worst_view_share=lambda model: model.least_view,
            match_count=lambda views: MATCHES,
        )
        options = SimpleNamespace(mapper=None, triangulation=None)
        first_pairs = SimpleNamespace(candidates=starts)
        found = growing._build_model(mapper, score, options, first_pairs, set(range(1, 11)))
        return (None if found is None else grown.index(found)), len(grown)

    return choose


EVEN, BENT = 0.9, 0.5  # scores of the worst view, over the median


@pytest.mark.parametrize(
    ("models", "best", "count"),
    [
        ([(0.83, BENT), (0.99, EVEN)], 1, 2),  # a bent model with a high score
        ([(0.7, EVEN), (0.99, EVEN)], 0, 1),
        # The scores differ by noise: two first pairs lead to the same model.
        ([(0.55, EVEN), (0.551, EVEN), (0.9, EVEN)], 1, 2),
        ([(0.83, BENT), (0.55, EVEN), (0.83, BENT)], 0, 3),
        ([(0.3, BENT), (0.83, BENT), (0.5, EVEN), (0.99, EVEN)], 1, 3),  # at most three are grown
        ([(0.83, BENT), (0.7, EVEN), (0.99, EVEN)], 1, 2),  # the even model is right
        ([(0.83, BENT)], 0, 1),
        ([], None, 0),
    ],
)
def test_best_score_counts(chosen, models, best, count):
    assert chosen([(10, score, 100, least) for score, least in models]) == (best, count)


def test_few_views_are_grown_twice(chosen):
    assert chosen([(4, 0.9, 100, EVEN), (4, 0.91, 100, EVEN), (4, 0.99, 100, EVEN)]) == (1, 2)


def test_triangulated_observations_do_not_count(chosen):
    models = [(10, 0.5, 4000, EVEN), (10, 0.7, 2000, BENT), (10, 0.4, 5000, EVEN)]
    assert chosen(models) == (1, 3)


def test_model_of_two_views_does_not_count(chosen):
    assert chosen([(2, 0.99, 100, EVEN), (3, 0.3, 100, EVEN)]) == (1, 2)
    assert chosen([(2, 0.99, 100, EVEN)]) == (None, 1)
