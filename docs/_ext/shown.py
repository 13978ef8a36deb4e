"""``{shown}`` with an expression: what a notebook shows for it, by its ``_repr_html_``."""

from docutils import nodes
from docutils.parsers.rst import Directive


class Shown(Directive):
    """The HTML of an expression of ``at``."""

    required_arguments = 1
    final_argument_whitespace = True

    def run(self):
        import antumbra

        value = eval(self.arguments[0], {"at": antumbra})
        return [nodes.raw("", f'<div class="table-wrapper shown">{value._repr_html_()}</div>', format="html")]


def setup(app):
    app.add_directive("shown", Shown)
    return {"parallel_read_safe": True}
