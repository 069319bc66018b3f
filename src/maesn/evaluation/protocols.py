"""How others evaluate in new tasks, by name: the settings that `--protocol` stands for."""

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

from maesn.envs import RewardKind
from maesn.settings import check_choice

ProtocolName: TypeAlias = Literal["metaworld-ml1"]


class Protocol(NamedTuple):
    """An evaluation as a source prescribes it.

    All but the last field are settings of `Evaluation`, by their names. The first two may be given
    other values: settings are chosen on validation tasks, and a method may learn more often from
    the same episodes.
    """

    tasks: str
    episodes_per_update: int
    episodes: int
    num_tasks: int
    reward: RewardKind
    deploy_episodes: int
    deploy_after: tuple[int, ...]
    measure: str
    """The number that is reported: a column of the table."""

    def settings(self) -> dict[str, Any]:
        """Return the settings of an evaluation."""
        return {name: value for name, value in self._asdict().items() if name != "measure"}


PROTOCOLS: Mapping[str, Protocol] = {
    # Farama-Foundation/Metaworld, `metalearning_evaluation` in metaworld/evaluation.py and
    # docs/evaluation/evaluation.md: one adaptation step of 10 episodes with the environment's own
    # reward, then 3 episodes for each of 40 goals; success at any step counts. It ends these
    # episodes at success, which changes returns alone.
    "metaworld-ml1": Protocol(
        tasks="test",
        episodes_per_update=10,
        episodes=10,
        num_tasks=40,
        reward="dense",
        deploy_episodes=3,
        deploy_after=(10,),
        measure="success_rate",
    ),
}
"""Name -> protocol."""

_FREE = ("tasks", "episodes_per_update")


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
        if name not in _FREE and found != value:
            raise ValueError(
                f"`{name}` is {value} by the protocol `{protocol}`, got {found}: leave out one of "
                "the two."
            )
