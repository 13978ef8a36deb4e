"""The templates of examples/cluster: their shell parts run as a scheduler would run them."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import antumbra as at

TEMPLATES = Path(__file__).resolve().parents[2] / "examples" / "cluster"
JOB = ("render", "procedural:atrium?triangles=2000", "--size", "48x70", "--spp", "4", "-o", "a b.png")
ANTUMBRA = f"""#!/usr/bin/env bash
# This antumbra, whose kernels are compiled, so that it only tells that it was to be warmed up.
[ "$1" = warmup ] && echo "$@" >>warmup.log || exec "{sys.executable}" -m antumbra "$@"
"""
SBATCH = """#!/usr/bin/env bash
# A scheduler that runs each job at once: it understands the options of the template, and refuses others.
set -euo pipefail
array= wrap=
while [ $# -gt 0 ]; do
    case $1 in
    --parsable | --requeue) shift ;;
    --array=*) array=${1#*=} && shift ;;
    --dependency=afterok:41) shift ;;
    --wrap=*) wrap=${1#*=} && shift ;;
    --*) echo "sbatch: $1" >&2 && exit 1 ;;
    *) break ;;
    esac
done
echo "$array|$wrap" >>sbatch.log
if [ -n "$wrap" ]; then
    sh -c "$wrap" >&2
else
    for i in $(seq "${array%-*}" "${array#*-}"); do SLURM_ARRAY_TASK_ID=$i SLURM_CPUS_ON_NODE=1 "$@" >&2; done
fi
echo 41
"""

pytestmark = [
    pytest.mark.programs,
    pytest.mark.skipif(shutil.which("bash") is None, reason="the templates are for bash"),
]


@pytest.fixture
def shell(tmp_path):
    """Runs words in a folder where ``antumbra`` is this one; returns the folder."""
    programs = tmp_path / "bin"
    programs.mkdir()
    put(programs / "antumbra", ANTUMBRA)
    put(programs / "sbatch", SBATCH)
    folder = tmp_path / "it's a folder"
    folder.mkdir()
    environment = {**os.environ, "PATH": f"{programs}:{os.environ['PATH']}"}

    def run(*words, code=0):
        done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True)
        assert done.returncode == code, done.stderr
        return done

    run.folder = folder
    return run


def put(path, text):
    path.write_text(text)
    path.chmod(0o755)


@pytest.fixture(scope="module")
def picture(tmp_path_factory) -> bytes:
    """The picture without shards."""
    path = tmp_path_factory.mktemp("whole") / "a b.png"
    subprocess.run([sys.executable, "-m", "antumbra", *JOB[:-1], path, "--quiet"], check=True)
    return path.read_bytes()


def test_slurm(shell, picture):
    shell(TEMPLATES / "slurm.sh", "3", "a b.shards", *JOB)
    assert (shell.folder / "a b.png").read_bytes() == picture
    assert (shell.folder / "sbatch.log").read_text().splitlines() == ["0-2|", "|antumbra merge a\\ b.shards"]
    assert (shell.folder / "warmup.log").read_text() == "warmup --quiet\n"
    assert "usage" in shell(TEMPLATES / "slurm.sh", code=2).stderr


def test_parallel(shell, picture):
    """By GNU parallel if it is here, else by xargs."""
    shell(TEMPLATES / "parallel.sh", "2", "a b.shards", *JOB)
    assert (shell.folder / "a b.png").read_bytes() == picture
    assert "usage" in shell(TEMPLATES / "parallel.sh", code=2).stderr


FLAMENCO = """
const author = {
    Task: (name, type) => ({ name, type, commands: [], after: [],
        addCommand(c) { this.commands.push(c); }, addDependency(t) { this.after.push(t.name); } }),
    Command: (name, parameters) => ({ name, parameters }),
};
const source = require("fs").readFileSync(process.argv[1], "utf8");
const [type, compile] = new Function("author", source + "; return [JOB_TYPE, compileJob];")(author);
const tasks = [];
compile({ settings: JSON.parse(process.argv[2]), addTask: (task) => tasks.push(task) });
console.log(JSON.stringify({ type, tasks }));
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="Flamenco's job type needs node: apt install nodejs")
def test_flamenco(shell, picture):
    words = 'render "procedural:atrium?triangles=2000" --size 48x70 --spp 4 -o "a b.png"'
    asked = {"folder": str(shell.folder), "command": words, "shards": 2, "shards_folder": "a b.shards"}
    told = json.loads(shell("node", "-e", FLAMENCO, TEMPLATES / "antumbra.js", json.dumps(asked)).stdout)
    assert {each["key"] for each in told["type"]["settings"]} == set(asked)
    assert [task["name"] for task in told["tasks"]] == ["shard-0", "shard-1", "merge"]
    assert told["tasks"][2]["after"] == ["shard-0", "shard-1"]
    for task in told["tasks"]:
        (command,) = task["commands"]
        assert command["name"] == "exec" and task["type"] == "misc"
        shell(command["parameters"]["exe"], *command["parameters"]["args"])
    assert (shell.folder / "a b.png").read_bytes() == picture


def test_kubernetes(shell):
    """The containers' commands, each with its index, as an indexed job would run them; without containers."""
    yaml = pytest.importorskip("yaml", reason="the Kubernetes template needs PyYAML: NOT checked")
    shards, merge = yaml.safe_load_all((TEMPLATES / "kubernetes.yaml").read_text())
    spec = shards["spec"]
    assert spec["completionMode"] == "Indexed" and spec["podFailurePolicy"]["rules"][0]["onExitCodes"]["values"] == [2]
    (container,) = spec["template"]["spec"]["containers"]
    (merging,) = merge["spec"]["template"]["spec"]["containers"]
    assert container["command"][-2:] == ["--shard", f"auto/{spec['completions']}"]
    shutil.copy(Path(at.examples.__file__).parent / "mill.glb", shell.folder / "city.glb")
    command = container["command"]
    shell(*command[:-2])
    whole = (shell.folder / "city.csv").read_bytes()
    (shell.folder / "city.csv").unlink()
    ignored, final = (rule["onExitCodes"]["values"] for rule in merge["spec"]["podFailurePolicy"]["rules"])
    assert final == [2]
    shell(*merging["command"], code=ignored[0])
    for i in range(spec["completions"]):
        shell("env", f"JOB_COMPLETION_INDEX={i}", *command)
    shell(*merging["command"])
    assert (shell.folder / "city.csv").read_bytes() == whole


def test_snakemake(shell, picture):
    snakemake = shutil.which("snakemake") or shutil.which("snakemake", path=Path(sys.executable).parent)
    if snakemake is None:
        pytest.skip("no snakemake: pip install snakemake; the Snakefile is NOT checked")
    words = 'render "procedural:atrium?triangles=2000" --size 48x70 --spp 4 -o "a b.png" --threads 1'
    config = ("shards=2", "output=a b.png", f"command={words}")
    shell(snakemake, "--snakefile", TEMPLATES / "Snakefile", "--cores", "1", "--config", *config)
    assert (shell.folder / "a b.png").read_bytes() == picture
