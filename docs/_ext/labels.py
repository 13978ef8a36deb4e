"""Labels of the bibliography as the docstrings write them: [Author Year]."""

from collections import Counter
from string import ascii_lowercase

from pybtex.plugin import register_plugin
from pybtex.style.formatting.unsrt import Style
from pybtex.style.labels import BaseLabelStyle


class AuthorYearLabels(BaseLabelStyle):
    """Such as "Wald 2007", "Benthin and Wald 2009", "Duff et al. 2017"; with letters, "2018a", where two are equal."""

    def format_labels(self, sorted_entries):
        labels, begun = list(self._plain(sorted_entries)), Counter()
        number = Counter(labels)
        for label in labels:
            yield label + ascii_lowercase[begun[label]] * (number[label] > 1)
            begun[label] += 1

    @staticmethod
    def _plain(entries):
        for entry in entries:
            names = ["".join(person.last_names) for person in entry.persons["author"]]
            who = " and ".join(names) if len(names) < 3 else f"{names[0]} et al."
            yield f"{who} {entry.fields['year']}"


class AuthorYearStyle(Style):
    default_label_style = AuthorYearLabels


def setup(app):
    register_plugin("pybtex.style.formatting", "author-year", AuthorYearStyle)
    return {"parallel_read_safe": True}
