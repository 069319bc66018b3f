"""The recipe for Weights & Biases, taken from its page and run without a network."""

import os
import subprocess
import sys
from pathlib import Path

from pages import ROOT, blocks_of

import maesn

PAGE = ROOT / "docs" / "howto" / "weights_and_biases.md"


def test_the_recipe_sends_every_number(tmp_path: Path) -> None:
    learner = maesn.PRESETS["maesn"](policy=maesn.GaussianMLP((8,)), meta_batch_size=2)
    settings = maesn.RunSettings(family="point", iterations=3, episodes_per_task=2)
    run = maesn.train(learner, settings, tmp_path / "runs" / "small")
    (tmp_path / "to_wandb.py").write_text(blocks_of(PAGE, "py")[0])
    offline = {"WANDB_MODE": "offline", "WANDB_DIR": str(tmp_path), "WANDB_SILENT": "true"}
    command = [sys.executable, "to_wandb.py", "runs/small"]
    subprocess.run(command, cwd=tmp_path, env=os.environ | offline, check=True)
    (log,) = tmp_path.glob("wandb/offline-run-*/run-*.wandb")
    written = log.read_bytes()
    rows = run.metrics()
    assert len(rows) == 3
    for row in rows:
        assert str(row["return_after"]).encode() in written
        assert str(row["outer/gradient_norm"]).encode() in written
