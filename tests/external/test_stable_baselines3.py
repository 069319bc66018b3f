"""The examples of Stable-Baselines3, which train on the library's environments through Gymnasium.

On the point, which needs no engine: that of the robots asks for a newer MuJoCo.
"""

import re
import subprocess
import sys
from pathlib import Path

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
STEPS = 1536  # three of PPO's updates


def test_ppo_gets_nearer_to_the_goal() -> None:
    example = EXAMPLES / "train_with_stable_baselines3.py"
    command = [sys.executable, example, "--env", "maesn/Point-v0", "--steps", str(STEPS)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    line = r": mean return (-\d+\.\d), \d+% of episodes end at the goal\n"
    found = re.fullmatch(f"before training{line}after {STEPS} steps{line}", done.stdout)
    assert found is not None, done.stdout
    before, after = map(float, found.groups())
    # 40 steps at 2 m from the goal, where a policy that has learned nothing stays.
    assert abs(before + 80) < 1
    assert after > before + 1


def test_rl2_plays_trials_of_three_episodes() -> None:
    command = [sys.executable, EXAMPLES / "rl2_with_stable_baselines3.py", "--reward", "dense"]
    done = subprocess.run(
        [*command, "--steps", "1024"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    returns = r"( -\d+\.\d\d){3}\n"
    assert re.fullmatch(f"before training:{returns}after 1024 steps:{returns}", done.stdout), done
