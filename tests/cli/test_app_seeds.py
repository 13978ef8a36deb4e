"""`--seed` draws other samples in every command that traces light samples, and 0 is the default."""

import OpenEXR
import pytest

SMALL = "--size", "24x16", "--spp", "2"
SCENE = "procedural:atrium?triangles=2000"


COMMANDS = {
    "render": ("render", SCENE, *SMALL, "-o", "{}.exr"),
    "render with bounced light": ("render", SCENE, *SMALL, "--bounce", "2", "-o", "{}.exr"),
    "render with point lights": ("render", SCENE, *SMALL, "--vpl", "40", "-o", "{}.exr"),
    "render with a sky": ("render", SCENE, *SMALL, "--sky", "white", "-o", "{}.exr"),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_seed_draws_other_samples(cli, tmp_path, name):
    def image(output, *seed):
        assert cli(*(word.format(output) for word in COMMANDS[name]), *seed).code == 0
        with OpenEXR.File(str(tmp_path / f"{output}.exr"), separate_channels=True) as file:
            return {n: c.pixels.tobytes() for n, c in file.channels().items()}

    usual, zero, five, again = image("a"), image("b", "--seed", 0), image("c", "--seed", 5), image("d", "--seed=5")
    assert usual == zero and five == again and five["R"] != usual["R"]
    assert five["depth.Z"] == usual["depth.Z"]


def test_a_seed_that_is_no_number_is_refused(cli):
    cli("render", SCENE, "--seed", "-1").refused("--seed")
    cli("render", SCENE, "--seed", "x").refused("--seed")
    cli("bake", "none.glb", "-o", "a.glb", "--seed", "-1").refused("--seed")


def test_shards_of_different_seeds_do_not_mix(cli):
    words = ["render", SCENE, *SMALL, "-o", "x.exr"]
    assert cli(*words, "--seed", 1, "--shard", "0/2").code == 0
    assert cli(*words, "--seed", 2, "--shard", "1/2").code == 2
