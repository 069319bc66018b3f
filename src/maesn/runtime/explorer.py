"""A robot that explores with a meta-learned policy and learns from what it finds."""

import os
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from maesn.runtime.acting import Actor
from maesn.runtime.arrays import FloatArray, finite_vector
from maesn.runtime.episode import Episode
from maesn.runtime.exported import ExportedPolicy
from maesn.runtime.learning import AdaptationInfo, learned
from maesn.runtime.policy import ConditionedPolicy
from maesn.runtime.safeguards import Safeguards
from maesn.runtime.search import Beliefs
from maesn.runtime.state import ExplorerState
from maesn.runtime.storage import Snapshot, read_snapshot, write_snapshot


class Explorer:
    """A fast learner for one task, one episode and one step at a time.

    A new task starts from the exported latent, usually the prior. At the start of every episode z
    is drawn from the present latent and kept until the end. `adapt` moves the latent along its
    policy gradient (section "Using the Latent Spaces for Exploration").

    A policy that was exported with the rule `search` chooses z instead, by what `adapt` has learned
    of the returns (`docs/explanation/methods/latent_search.md`): adapt after every episode.

    A method that raises has changed nothing: the call can be repeated with better arguments. Not
    to be shared between threads.

    Args:
        exported: what meta-training handed over.
        state: the state to continue from; by default the start of a new task.
        safeguards: limits on the executed controls and on the latent.
        seed: seed of all random draws; None for fresh randomness of the operating system.
    """

    def __init__(
        self,
        exported: ExportedPolicy,
        state: ExplorerState | None = None,
        safeguards: Safeguards | None = None,
        seed: int | None = None,
    ) -> None:
        self.exported = exported
        self.safeguards = Safeguards() if safeguards is None else safeguards
        self._generator = np.random.default_rng(seed)
        self._actor = Actor(exported, self.safeguards, self._generator)
        state = ExplorerState.new_task(exported) if state is None else state
        if state.search is not None:
            bound = self.safeguards.max_latent_norm
            search = replace(state.search, max_norm=np.inf if bound is None else bound)
            state = replace(state, search=search)
        self._state = state
        self._policy = self._given_z()

    @staticmethod
    def load(
        path: str | os.PathLike[str], seed: int | None = None, safeguards: Safeguards | None = None
    ) -> "Explorer":
        """Return the explorer of a file.

        Args:
            path: written by `maesn export` (a new task begins) or by `save` (goes on exactly
                where it stopped).
            seed: seed of all later random draws. None goes on with the saved random state, or,
                in a new task, takes fresh randomness of the operating system.
            safeguards: None takes the saved ones; in a new task there are none.

        Raises:
            OSError: the file cannot be opened.
            ValueError: it is no such file, it is damaged, or the safeguards do not fit it.
        """
        try:
            found = read_snapshot(path)
            kept = found.safeguards if safeguards is None else safeguards
            explorer = Explorer(found.exported, found.state, kept, seed)
        except ValueError as error:
            raise ValueError(f"{os.fspath(path)}: {error}") from error
        if seed is None and found.random_state is not None:
            explorer._generator.bit_generator.state = found.random_state
        return explorer

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write everything to one file, in the middle of a batch or even of an episode.

        The file holds the policy, the latent, all episodes since the last `adapt`, the safeguards
        and the random state, so `load` goes on as if nothing had happened. Whatever happens, `path`
        holds the old or the new file; OSError says that it cannot be written.
        """
        random_state = self._generator.bit_generator.state
        write_snapshot(path, Snapshot(self.exported, self._state, self.safeguards, random_state))

    @property
    def latent_mean(self) -> FloatArray:
        """Mean of the latent that the next z is drawn from, `[latent]`.

        With a search, from the first `adapt` on, the latent to deploy.
        """
        return self._state.latent.mean.copy()

    @property
    def latent_std(self) -> FloatArray:
        """Standard deviation of the latent that the next z is drawn from, `[latent]`."""
        return self._state.latent.std

    @property
    def beliefs(self) -> Beliefs:
        """What a search believes of the returns; raises RuntimeError where there is no search."""
        return self._state.search_for("beliefs").beliefs

    @property
    def update(self) -> int:
        """Number of updates behind the latent: calls of `adapt`, and those before the export."""
        return self._state.update

    @property
    def episodes(self) -> tuple[Episode, ...]:
        """The episodes that the next `adapt` learns from."""
        return self._state.episodes

    @property
    def is_running(self) -> bool:
        """Whether an episode has begun and not yet ended."""
        return self._state.running is not None

    def begin_episode(self, explore: bool = True, z: ArrayLike | None = None) -> FloatArray:
        """Begin an episode, and fix its z.

        By default z is drawn from the present latent, and `adapt` learns from the episode. An
        episode with a chosen z is learned from in the same way, by the likelihood of that z under
        the latent. This is the gradient of the return only where choices follow the latent's
        distribution, as pairs mean + d and mean - d do. A z far from the mean makes a large step.

        Args:
            explore: False holds z at the latent's mean, for a robot at work or to judge what it
                has learned. `adapt` ignores such an episode. Whether actions are drawn is as in
                the simulation; `act(observation, explore=False)` takes their mean.
            z: the caller's choice of z, `[latent]`; None for a draw.

        Returns:
            z, `[latent]`.

        Raises:
            RuntimeError: an episode is running.
            ValueError: z has the wrong size or is not finite, or comes with `explore=False`.
        """
        self._state.refuse_running("begin_episode")
        if not explore and z is not None:
            raise ValueError(
                "`explore=False` holds z at the latent's mean, so that `z` cannot be chosen as "
                "well: leave out one of them."
            )
        size = self.exported.latent_size
        chosen = None if z is None else finite_vector("z", z, size, "as the policy's latent")
        self._state = self._state.begun(explore, chosen, self._generator)
        self._policy = self._given_z()
        return self._state.running_for("begin_episode").latent.copy()

    def propose(self, count: int) -> FloatArray:
        """Choose z for several robots to play at the same time, `[robot, latent]`.

        Each is chosen as if those before it had returned what the search expects of them. Play
        them with `begin_episode(z=...)`, or report with `add_result` what other robots got, in any
        order: `adapt` learns in the order of proposal. One that is never played does no harm. Call
        `adapt` before the next proposal, which knows nothing of those that are still played.

        Raises:
            RuntimeError: an episode is running, or there is no search.
            ValueError: `count` is not at least 1.
        """
        self._state.refuse_running("propose")
        if count < 1:
            raise ValueError(f"`count` must be at least 1, got {count}.")
        search = self._state.search_for("propose")
        search, proposed = search.proposed_together(self._generator, count)
        self._state = replace(self._state, search=search, proposed=proposed)
        return search.points[list(proposed)]

    def add_result(self, z: ArrayLike, rewards: ArrayLike) -> None:
        """Keep what another robot got with a z of this search; the next `adapt` learns from it.

        Args:
            z: one of those that `propose` returned, or another of this search, `[latent]`.
            rewards: r_t of every step of its episode, `[time]`.

        Raises:
            RuntimeError: there is no search.
            ValueError: z is no point of this search, or the rewards are not finite or none.
        """
        size, search = self.exported.latent_size, self._state.search_for("add_result")
        point = search.index(finite_vector("z", z, size, "as the policy's latent"))
        steps = max(np.size(rewards), 1)
        checked = finite_vector("rewards", rewards, steps, "one for each step of the episode")
        self._state = self._state.told(point, checked, self.exported.search_horizon)

    def act(
        self, observation: ArrayLike, explore: bool | None = None, normalized: bool = False
    ) -> FloatArray:
        """Return what to send to the actuators now.

        Controls are in the actuators' units (N m on `wheeled`). The environments of `maesn.gym`
        take [-1, 1] instead: give them `normalized=True`.

        Args:
            observation: o_t, `[observation]`.
            explore: whether to draw the action from the policy, rather than to take its mean; None
                for what the simulation does in episodes of this purpose (`exported.is_noisy`).
            normalized: whether to return the control on the scale on which the limits of training
                are -1 and 1.

        Returns:
            The control, within all limits, `[action]`.

        Raises:
            RuntimeError: no episode is running.
            ValueError: the observation has the wrong size or is not finite, the policy's answer to
                it or the control is not finite, or `normalized` is asked of actuators without
                limits.
        """
        running, size = self._state.running_for("act"), self.exported.observation_size
        seen = finite_vector("observation", observation, size, "as in training")
        return self._actor.act(self._policy, running, seen, explore, normalized)

    def control(self, action: ArrayLike) -> FloatArray:
        """Return what the actuators would get for an action of the policy, `[action]`.

        Scaled and clipped, but without the limit on its change, which depends on the step before.
        """
        size = self.exported.action_size
        checked = finite_vector("action", action, size, "as in training")
        return self._actor.actuators.control(checked)

    def end_episode(self, rewards: ArrayLike) -> Episode:
        """Finish the running episode, keep it for `adapt` if it explored, and return it.

        Args:
            rewards: r_t of every step that was taken, `[time]`.

        Raises:
            RuntimeError: no episode is running, or it has no step yet.
            ValueError: not one finite reward for every step. The episode is still running.
        """
        running = self._state.running_for("end_episode")
        if running.num_steps == 0:
            raise RuntimeError(
                "`end_episode` needs at least one step, but `act` has not been called since "
                "`begin_episode`; act, or call `discard()`."
            )
        reason = "one for each call of `act`"
        episode = running.finished(finite_vector("rewards", rewards, running.num_steps, reason))
        kept = (episode,) if running.purpose == "explore" else ()
        episodes = (*self._state.episodes, *kept)
        self._state = replace(self._state, episodes=episodes, running=None)
        return episode

    def discard(self) -> None:
        """Throw the running episode away, and keep the finished ones.

        Raises:
            RuntimeError: no episode is running.
        """
        self._state.running_for("discard")
        self._state = replace(self._state, running=None)

    def adapt(self) -> AdaptationInfo:
        """Learn from all exploring episodes since the last call, and forget them.

        Moves the latent. A search warns, once, of returns that its prior cannot explain, as of
        rewards in another unit.

        Raises:
            RuntimeError: an episode is running, there are fewer than two finished episodes to
                learn from (one with a search), or the update is not finite. The episodes are kept.
        """
        self._state.refuse_running("adapt")
        horizon = self.exported.search_horizon
        self._state, info = learned(self._state, self.exported.rule, self.safeguards, horizon)
        return info

    def _given_z(self) -> ConditionedPolicy:
        running = self._state.running
        latent = self._state.latent.mean if running is None else running.latent
        return self.exported.policy.given(latent)
