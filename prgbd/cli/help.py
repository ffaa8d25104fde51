"""``python -m prgbd --help``."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from rich.console import Console
from rich.table import Table

from prgbd.cli.arguments import GROUPS, PLUGIN_GROUPS
from prgbd.cli.hydra_bridge import conf_folders
from prgbd.core.registry import REGISTRY

EXAMPLES = (
    ("the self-improving loop on a synthetic street", "slam=orb_gtsam depth=monodepth2 depth.weights=demo"),
    (
        "SLAM alone on your own video",
        "slam=orb_gtsam task=slam data=video data.root=FILE.mp4 data.fov=70",
    ),
    (
        "the loop on your own video (W: a folder of trained weights)",
        "slam=orb_gtsam depth=monodepth2 depth.weights=W data=video data.root=FILE.mp4 data.fov=70",
    ),
    (
        "the loop on KITTI odometry 00",
        "slam=orb_gtsam depth=monodepth2 depth.weights=W data=kitti_odometry data.root=KITTI 'data.sequences=[00]'",
    ),
    (
        "SLAM alone, on an RGB-D camera",
        "slam=orb_gtsam task=slam slam.mode=rgbd data=tum_rgbd data.root=TUM",
    ),
    (
        "depth maps of a folder of images",
        "depth=monodepth2 depth.weights=W task=depth data=images data.root=FOLDER",
    ),
    ("which loss term matters (four runs, one table)", "-m experiment=smoke loss=all,no_photometric,no_depth_transfer"),
    ("go on with a run that was stopped", "resume=last"),
)
OPTIONS = (
    ("seed=0", "same seed, same machine, same result"),
    ("out=FOLDER", "where the run is written; outputs/DATE/TIME unless given"),
    ("resume=FOLDER", "go on with that run (resume=last: the newest unfinished one)"),
    ("task.max_loops=3", "refinements of the network at most; fewer if nothing improves"),
    ("slam.mode=auto", "auto, mono, rgbd (the sensor's depth), stereo (right images) or pseudo_rgbd (the network)"),
    (
        "slam.baseline=auto",
        "metres; auto adapts the virtual baseline to the network's depth: 0.54 / 80 * largest depth",
    ),
    ("depth.weights=W", "folder of the weights of the network"),
    ("data.root=FOLDER", "where the recordings lie"),
    ("data.sequences=[A,B]", "which recordings; data.test_sequences=[C] are evaluated but not trained on"),
    ("loss.depth_transfer=0.1", "the weight of a loss term; loss.ID switches on one that another package brings"),
    ("training.learning_rate=1e-6", "and training.epochs=1: the refinement"),
    ("trainer.devices=1", "any option of lightning.Trainer that conf/trainer lists"),
    ("debug=true", "show tracebacks"),
)


def choices(group: str) -> list[str]:
    """Return the choices of a configuration group: its YAML files and, for plug-ins, the registered ids."""
    folders = [Path(str(resources.files("prgbd.conf"))), *(folder for _, folder in conf_folders())]
    names = {path.stem for folder in folders for path in (folder / group).glob("*.yaml")}
    if group in PLUGIN_GROUPS:
        names |= {spec.id for spec in REGISTRY.specs(group)}
    return sorted(names)


def print_help(console: Console) -> None:
    """Print what prgbd does, the groups with their choices, examples and the important options."""
    console.print(
        "[bold]prgbd[/bold] makes a depth network and a SLAM system improve each other from unlabelled video:\n"
        "the network is the depth sensor of RGB-D SLAM, SLAM's poses and points refine the network, and again.\n"
    )
    console.print("[bold]python -m prgbd slam=ID depth=ID [GROUP=CHOICE ...] [OPTION=VALUE ...]", highlight=False)
    console.print()
    groups = Table(title="Groups", title_justify="left", box=None, pad_edge=False, show_header=False)
    groups.add_column(style="bold", no_wrap=True)
    groups.add_column()
    for group in GROUPS:
        groups.add_row(group, ", ".join(choices(group)))
    examples = Table(title="Examples", title_justify="left", box=None, pad_edge=False, show_header=False)
    examples.add_column()
    for what, command in EXAMPLES:
        examples.add_row(f"[dim]# {what}[/dim]")
        examples.add_row(f"python -m prgbd {command}".replace("[", "\\["))
    options = Table(title="Options", title_justify="left", box=None, pad_edge=False, show_header=False)
    options.add_column(style="bold", no_wrap=True)
    options.add_column()
    for option, what in OPTIONS:
        options.add_row(option.replace("[", "\\["), what)
    for table in (groups, examples, options):
        console.print(table)
        console.print()
    console.print(
        "python -m prgbd --help training (sensing, task, evaluation, slam, ..., or one option) says what its options "
        "mean; python -m prgbd.plugins lists the plug-ins; --cfg job prints the configuration of a command.",
        style="dim",
    )
