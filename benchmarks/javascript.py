"""The package for JavaScript beside three-mesh-bvh, in node: times of builds and rays, and wrong answers.

    python benchmarks/javascript.py [SCENE ...] [--rays N] [--rounds N] [--json FILE]

Both trace the same float32 rays with one thread, in turns of one process: shadow rays to a point in the middle, from
points a thousandth of the way in front of surfaces, rays from a camera there, random rays, and random rays through
vertices. three-mesh-bvh has a call for one ray, `raycastFirst`, which answers any-hit queries too. Its tree is built by
the surface area heuristic. Answers are compared with those of Antumbra in Python. npm installs three-mesh-bvh into a
temporary folder.

Soft shadows are those of the surfaces in a picture of 640 x 360 pixels, with 16 samples of a lamp in the middle. The
time of three-mesh-bvh is that of each 16th point's segments, times 16.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import antumbra as at
from antumbra.base.errors import InputError
from antumbra.query.light_samples import domain_sets
from antumbra.query.receivers import Receivers
from antumbra.web.javascript_package import build_package
from common import SCENES, arguments, machine
from comparison import start

PEERS = "three@0.180", "three-mesh-bvh@0.9.17"
REAL = "sponza_crytek", "bart_robots"
SCRIPT = Path(__file__).with_suffix(".mjs")
PICTURE = 640, 360
EACH = 16  # of the points whose segments three-mesh-bvh traces


def install(folder: Path) -> None:
    """Build the package, and install the peers beside it."""
    (folder / "package.json").write_text('{"type": "module"}')
    try:
        subprocess.run(["npm", "install", "--silent", "--no-audit", "--no-fund", *PEERS], cwd=folder, check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        raise InputError(f"npm did not install {' and '.join(PEERS)}: {error}") from None
    build_package(folder / "node_modules" / "antumbra")


def rays(vertices: np.ndarray, n: int, seed: int = 1) -> dict[str, tuple[np.ndarray, np.ndarray, float]]:
    """Kind -> (origins, directions, tmax), float32; directions have the length of their segment, or one."""
    rng = np.random.default_rng(seed)
    lower, upper = vertices.min((0, 1)), vertices.max((0, 1))
    middle = ((lower + upper) / 2).astype(np.float32)
    faces = vertices[rng.integers(0, len(vertices), n)]
    points = (rng.dirichlet((1, 1, 1), n)[:, :, None] * faces).sum(1)
    points = (points + (middle - points) / 1000).astype(np.float32)
    width = np.ceil(np.sqrt(n)).astype(int)
    across = (np.stack(np.divmod(np.arange(n), width), 1) / width - 0.5).astype(np.float32)
    view = np.column_stack([across[:, 1], -across[:, 0], np.full(n, -0.7, np.float32)])
    anywhere = rng.uniform(lower, upper, (n, 3)).astype(np.float32)
    around = rng.normal(size=(n, 3)).astype(np.float32)
    return {
        "shadow": (points, middle - points, 1.0),
        "camera": (np.broadcast_to(middle, (n, 3)), view, np.inf),
        "random": (anywhere, around, np.inf),
        "through vertices": (anywhere, faces[:, 0] - anywhere, np.inf),
    }


def write_soft_shadows(scene: at.Scene, path: Path, folder: Path) -> dict:
    """Write the points of a picture and their answers, and return what the script needs to know."""
    surfaces = scene.engine.surfaces(at.load(path).default_camera(*PICTURE))
    there = surfaces.face >= 0
    points = (surfaces.position[there] + surfaces.origin).astype(np.float32)
    normals = np.ascontiguousarray(surfaces.normal[there])
    lower, upper = scene.bounds
    size = (upper - lower).max()
    corner = ((lower + upper) / 2 + [0, 0.3 * (upper - lower)[1], 0]).astype(np.float32)
    light = at.QuadLight(corner, [0.05 * size, 0, 0], [0, 0, 0.05 * size])
    seen = at.visibility(scene, points, light, normals)
    own = Receivers.of(points, normals, scene.origin, scene.middle).origins[0] + scene.origin
    samples = domain_sets(16, "larcher-pillichshammer", "square")[np.arange(len(points)) & 3][::EACH]
    ends = light.corner + samples[..., :1] * light.u + samples[..., 1:2] * light.v
    above = ((ends - own[::EACH, None]) * normals[::EACH, None]).sum(-1) > 0
    arrays = {
        "points": points,
        "normals": normals,
        "bits": seen.bits,
        "starts": np.broadcast_to(own[::EACH, None], ends.shape)[above].astype(np.float32),
        "ends": ends[above].astype(np.float32),
        "blocked": ~seen.seen_samples[::EACH][above],
    }
    for name, array in arrays.items():
        array.tofile(folder / f"soft-{name}")
    vectors = {name: getattr(light, name).tolist() for name in ("corner", "u", "v")}
    return {"light": {"kind": "quad", **vectors}, "share": EACH}


def measure(path: Path, folder: Path, n: int, rounds: int) -> list[dict]:
    """A row per query and kind of rays, and one for the build."""
    vertices = np.ascontiguousarray(at.load(path).triangles().vertices)
    scene = at.Scene.from_arrays(vertices)
    vertices.tofile(folder / "positions")
    kinds = rays(vertices, n)
    for kind, (origins, directions, tmax) in kinds.items():
        for name, array in ("origins", origins), ("directions", directions):
            np.ascontiguousarray(array, np.float32).tofile(folder / f"{kind}-{name}")
        scene.occluded(origins, directions, tmax=tmax).tofile(folder / f"{kind}-blocked")
        scene.closest_hit(origins, directions, tmax=tmax).face.astype(np.int32).tofile(folder / f"{kind}-face")
    limits = {kind: None if tmax == np.inf else tmax for kind, (_, _, tmax) in kinds.items()}
    soft = write_soft_shadows(scene, path, folder)
    (folder / "plan.json").write_text(json.dumps({"limits": limits, "soft": soft, "rounds": rounds}))
    script = folder / SCRIPT.name  # so that its imports are found
    script.write_bytes(SCRIPT.read_bytes())
    done = subprocess.run(["node", script], cwd=folder, check=True, capture_output=True, text=True)
    rows = [{"scene": path.parent.name, "triangles": len(vertices), **row} for row in json.loads(done.stdout)]
    for row in rows:
        print(line(row), flush=True)
    return rows


def line(row: dict) -> str:
    """A row for the terminal."""
    text = f"{row['scene']:16} {row['query']:12} {row['rays']:17} {row['ours']:9.1f} ms {row['theirs']:9.1f} ms"
    return f"{text} {row['theirs'] / row['ours']:6.1f} x  wrong: {row['wrong']} and {row['wrong_theirs']}"


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--rays", type=int, default=200_000, help="rays of each kind")
    parser.set_defaults(rounds=3)
    options = parser.parse_args()
    found = [path for name in REAL for path in sorted((SCENES / name).glob("*.g*"))[:1]]
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work)
        install(folder)
        scenes = options.scene or found
        rows = [row for path in scenes for row in measure(path, folder, options.rays, options.rounds)]
    if options.json is not None:
        about = {**machine(1), "node": node_version(), "peers": PEERS}
        options.json.write_text(json.dumps({"machine": about, "rows": rows}, indent=1) + "\n")


def node_version() -> str:
    """The version of node."""
    return subprocess.run(["node", "--version"], check=True, capture_output=True, text=True).stdout.strip()


if __name__ == "__main__":
    sys.exit(start(main))
