// Order of the results of the site's search: pages for users first, then the reference, then evidence and decisions.
var Scorer = {
  score: ([page, , , , score]) =>
    score - (/^(evidence\/|decisions\/|(detection|faults)$)/.test(page) ? 40 : page.startsWith("reference/") ? 20 : 0),
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
