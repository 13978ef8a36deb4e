// Ranks guides above pages of commands and of the reference that have a word only in their text, and these above design
// notes and papers.
const TEXT = 10;
window.Scorer = {
  score: ([name, , , , score]) => {
    if (/^(design|papers)\//.test(name)) return score - 100;
    return /^(api|cli)\//.test(name) && score < TEXT ? score / TEXT : score;
  },
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
