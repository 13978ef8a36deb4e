"""Labels of the bibliography as the docstrings write them: [Author Year]."""

from pybtex.plugin import register_plugin
from pybtex.style.formatting.unsrt import Style
from pybtex.style.labels import BaseLabelStyle


class AuthorYearLabels(BaseLabelStyle):
    """Such as "Wald 2007", "Benthin and Wald 2009", "Duff et al. 2017"."""

    def format_labels(self, sorted_entries):
        for entry in sorted_entries:
            names = ["".join(person.last_names) for person in entry.persons["author"]]
            who = " and ".join(names) if len(names) < 3 else f"{names[0]} et al."
            yield f"{who} {entry.fields['year']}"


class AuthorYearStyle(Style):
    default_label_style = AuthorYearLabels


def setup(app):
    register_plugin("pybtex.style.formatting", "author-year", AuthorYearStyle)
    return {"parallel_read_safe": True}
