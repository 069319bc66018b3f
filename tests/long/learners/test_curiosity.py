"""The bonus of a model that has learned some of the dynamics."""

from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
from learning_problems.transitions import episodes_of, linear_episodes

from maesn.learners.wrappers.curiosity import CuriosityBonus

KEY = jax.random.key(0)
# Compiled, as the learners call them.
judge, learn = (eqx.filter_jit(method) for method in (CuriosityBonus.judge, CuriosityBonus.learn))


def test_what_is_known_is_worth_less_than_what_is_new() -> None:
    curiosity = CuriosityBonus(updates=1500)
    state, _ = judge(curiosity, KEY, curiosity.init(KEY, 2, 1), linear_episodes(1, (20,), 25, 0.05))
    known = linear_episodes(2, (8,), 25, noise=0.05)
    new = replace(known, action=known.action + 4.0)  # pushed harder, without any effect
    both = episodes_of(*(np.concatenate([getattr(e, f) for e in (known, new)]) for f in (
        "observation", "action",
    )))  # fmt: skip
    learned = learn(curiosity, KEY, state)
    _, bonus = judge(curiosity, KEY, learned, both)
    assert np.median(bonus[8:]) > 10 * np.median(bonus[:8])
