"""The reference begins with what is read first: a short signature, the summary, and an example.

Signatures with many parameters are shortened to their first ones; a click shows all. The section Examples of a
docstring follows its first paragraph, without its title.
"""

from docutils import nodes
from folds import fold
from sphinx import addnodes

LONGEST = 6
"""Parameters of a signature that is shown whole."""

TITLE = "Examples"


def shorten(signature: addnodes.desc_signature) -> None:
    """Show the names of the first parameters of a long signature, and all parameters below, folded."""
    whole = next(signature.findall(addnodes.desc_parameterlist), None)
    count = 0 if whole is None else sum(map(_is_parameter, whole))
    if count <= LONGEST:
        return
    short = addnodes.desc_parameterlist(multi_line_parameter_list=False)
    short += [addnodes.desc_parameter("", "", each[0].deepcopy()) for each in _first(whole.children)]
    short += addnodes.desc_parameter("", "", addnodes.desc_sig_operator("", "…"))
    signature[signature.index(whole)] = short
    line = addnodes.desc_signature_line("", "", *signature.children, add_permalink=True)
    signature["is_multiline"], signature.children = True, []
    signature += [line, *fold(f"all {count} parameters", [whole])]


def _is_parameter(node: nodes.Node) -> bool:
    """Whether a node is a parameter; signs such as * are nodes of the same kind."""
    return isinstance(node[0], addnodes.desc_sig_name)


def _first(parameters: list[nodes.Node]) -> list[nodes.Node]:
    """The parameters that a short signature shows: those before a sign, with the sign, or the first ones."""
    signs = [k for k, each in enumerate(parameters) if k > 0 and not _is_parameter(each)]
    return parameters[: min([*(k + 1 for k in signs), LONGEST - 1])]


def move_examples(content: addnodes.desc_content) -> None:
    """Move the examples of a docstring behind its first paragraph."""
    title = next((node for node in content if isinstance(node, nodes.rubric) and node.astext() == TITLE), None)
    first = next((node for node in content if isinstance(node, nodes.paragraph)), None)
    if title is None or first is None:
        return
    begin = content.index(title)
    ends = (nodes.rubric, nodes.field_list, addnodes.desc, addnodes.index)
    stop = (k for k, node in enumerate(content.children) if k > begin and isinstance(node, ends))
    end = next(stop, len(content))
    examples = content.children[begin + 1 : end]
    del content[begin:end]
    place = content.index(first) + 1
    content[place:place] = examples


def order(app, doctree) -> None:
    """Shorten the signatures of a page, and move its examples."""
    for signature in list(doctree.findall(addnodes.desc_signature)):
        shorten(signature)
    for content in list(doctree.findall(addnodes.desc_content)):
        move_examples(content)


def setup(app):
    app.connect("doctree-read", order, priority=900)  # after the links to sources
    return {"parallel_read_safe": True}
