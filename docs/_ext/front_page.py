"""What search engines and previews of links say of the site: the title and the description of the front page."""

TITLE = "Antumbra: exact shadows, sun hours and lines of sight in Python"
DESCRIPTION = (
    "Find out exactly which points see which lights: ray-traced shadows, sun hours and lines of sight for triangle "
    "meshes, in Python."
)


def describe(app, page, template, context, tree):
    context["site_title"] = TITLE
    if page == app.config.root_doc:
        texts = {"description": DESCRIPTION, "og:title": TITLE, "og:description": DESCRIPTION}
        context["meta"] = {**(context.get("meta") or {}), **texts}


def setup(app):
    app.connect("html-page-context", describe, priority=100)  # before tags are made of them
    return {"parallel_read_safe": True, "parallel_write_safe": True}
