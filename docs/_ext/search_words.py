"""Words that readers search for, and the page that answers them, which the search lists first."""

from sphinx.addnodes import index

PAGES = {
    "install": "install", "pip": "install", "uv": "install", "conda": "install",
    "python": "quickstart", "numpy": "quickstart",
    "glb": "files", "gltf": "files", "obj": "files", "ply": "files", "format": "files",
    "trimesh": "tutorials/others", "open3d": "tutorials/others", "pyvista": "tutorials/others",
    "embree": "tutorials/others", "mitsuba": "tutorials/others", "ladybug": "tutorials/others",
    "skyline": "jobs/skyline", "horizon": "jobs/skyline",
    "window": "jobs/sun", "latitude": "cities", "longitude": "cities", "location": "cities",
    "noise": "tutorials/pictures", "filter": "tutorials/pictures", "denoise": "jobs/bake",
    "opacity": "tutorials/model", "transparency": "tutorials/model", "material": "tutorials/model",
    "lightmap": "jobs/bake", "ambient occlusion": "jobs/bake", "bake": "jobs/bake",
    "viewshed": "jobs/line-of-sight", "visibility": "jobs/line-of-sight", "line of sight": "jobs/line-of-sight",
    "lines of sight": "jobs/line-of-sight",
    "shadow": "jobs/shadow", "sun": "jobs/sun", "sun hours": "jobs/sun",
    "solar": "jobs/sun", "daylight": "jobs/sun", "shading": "jobs/sun",
    "sky view factor": "jobs/sun", "view factor": "jobs/view-factors",
    "terrain": "terrain", "qgis": "maps", "cityjson": "cities", "gpu": "gpu", "cuda": "gpu", "opencl": "gpu",
    "dataset": "jobs/dataset", "jupyter": "notebook", "colab": "notebook", "error": "errors",
    "bvh": "concepts", "tree": "concepts", "epsilon": "concepts", "glare": "which-tool", "radiance": "which-tool",
    "wrong": "wrong-elsewhere", "acne": "wrong-elsewhere", "leak": "wrong-elsewhere",
}  # fmt: skip
"""Word -> page."""

MORE = {
    "opacity": ("api/scene", "jobs/shadow", "cli/render"), "transparency": ("api/scene", "jobs/shadow", "cli/render"),
    "window": ("sun-reference",), "latitude": ("jobs/sun",), "longitude": ("jobs/sun",),
    "noise": ("errors", "jobs/bake"),
}  # fmt: skip
"""Word -> further pages on it, which do not use the word itself."""


def add_words(app, doctree) -> None:
    """Add the words of a page to its index."""
    name = app.env.docname
    entries = [("single", word, "", "main", None) for word, page in PAGES.items() if page == name]
    entries += [("single", word, "", "", None) for word, pages in MORE.items() if name in pages]
    if entries:
        doctree.insert(0, index(entries=entries, inline=False))


def setup(app):
    app.connect("doctree-read", add_words)
    return {"parallel_read_safe": True}
