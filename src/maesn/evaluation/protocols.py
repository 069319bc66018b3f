"""How others evaluate in new tasks, by name: the settings that `--protocol` stands for."""

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

from maesn.envs import RewardKind
from maesn.settings import check_choice

ProtocolName: TypeAlias = Literal["maesn", "pearl", "varibad", "metaworld-ml1"]


class Protocol(NamedTuple):
    """An evaluation as a source prescribes it.

    All but the last two fields are settings of `Evaluation`, by their names.
    """

    episodes_per_update: int
    episodes: int
    num_tasks: int | None = None
    reward: RewardKind = "sparse"
    deploy_episodes: int = 1
    deploy_after: tuple[int, ...] = ()
    tasks: str = "test"
    measure: str = "mean_return"  # what is reported after the last episode: a column of the table
    # Settings that may be given other values, because the source has several, or tasks may be those
    # of validation, on which settings are chosen.
    free: tuple[str, ...] = ("tasks", "num_tasks", "episodes")

    def settings(self) -> dict[str, Any]:
        """Return the settings of an evaluation."""
        found = self._asdict()
        return {name: found[name] for name in found if name not in ("measure", "free")}


PROTOCOLS: Mapping[str, Protocol] = {
    # The paper's figures: ten updates by policy gradient, of fifty episodes or, on block pushing,
    # of twenty; judged by the episodes that are learned from, z drawn.
    "maesn": Protocol(
        episodes_per_update=50,
        episodes=500,
        deploy_episodes=0,
        free=("tasks", "num_tasks", "episodes", "episodes_per_update"),
    ),
    # katerakelly/oyster, `_do_eval` in rlkit/core/rl_algorithm.py, configs/sparse-point-robot.json:
    # twenty episodes of twenty tasks, actions without noise; the last one counts. On robots they
    # are three, 600 steps. There z of the last episode is a draw from the posterior, here its mean.
    "pearl": Protocol(episodes_per_update=1, episodes=19, num_tasks=20),
    # lmzintgraf/varibad, `evaluate` in utils/evaluation.py: the return of each episode of a trial,
    # actions without noise. A trial has three episodes on its point goals, four on GridNavi, two
    # on robots; the tasks are drawn afresh.
    "varibad": Protocol(episodes_per_update=1, episodes=2),
    # Farama-Foundation/Metaworld, `metalearning_evaluation` in metaworld/evaluation.py and
    # docs/evaluation/evaluation.md: one adaptation step of 10 episodes with the environment's own
    # reward, then 3 episodes for each of 40 goals; success at any step counts. It ends these
    # episodes at success, which changes returns alone. A method may learn more often from the same
    # episodes.
    "metaworld-ml1": Protocol(
        episodes_per_update=10,
        episodes=10,
        num_tasks=40,
        reward="dense",
        deploy_episodes=3,
        deploy_after=(10,),
        measure="success_rate",
        free=("tasks", "episodes_per_update"),
    ),
}
"""Name -> protocol."""


def settings_by(protocol: str | None) -> dict[str, Any]:
    """Return the settings of an evaluation by a protocol: none by None; `ValueError` if unknown."""
    if protocol is None:
        return {}
    check_choice("protocol", protocol, get_args(ProtocolName))
    return {**PROTOCOLS[protocol].settings(), "protocol": protocol}


def check_protocol(protocol: str | None, settings: Any) -> None:
    """Refuse by ValueError settings of an evaluation that its protocol has otherwise."""
    for name, value in settings_by(protocol).items():
        found = getattr(settings, name)
        if name not in PROTOCOLS[str(protocol)].free and found != value:
            raise ValueError(
                f"`{name}` is {value} by the protocol `{protocol}`, got {found}: leave out one of "
                f"the two. In Python, `maesn.Evaluation().changed(protocol={protocol!r})` sets all."
            )
