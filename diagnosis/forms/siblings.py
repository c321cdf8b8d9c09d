"""One law in all elements of a port: a sensor that is not linear is so in each of its axes.

Terms are chosen one by one. Where two say nearly the same of these runs, such as x^2 and -x |x| where x is hardly ever positive, chance
takes one; another run may tell them apart. What the other elements of the array do says more than chance. So a law with one coefficient in
all elements is a term, too, as long as terms are chosen; then each element has its own.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from robomill.diagnosis.forms.library import Term
from robomill.diagnosis.forms.selection import Products, pruned, worse
from robomill.diagnosis.forms.signals import index_of
from robomill.orchestration.slaves.protocol import base_name

Law = tuple[str, str]
"""Array of the port, and the text of the term with its own index as `i`."""


def law(element: str, term: Term) -> Law:
    """What is the same in all elements."""
    return base_name(element), term.pattern(index_of(element))


def together(terms: Sequence[tuple[str, Term]]) -> list[list[int]]:
    """The `terms` (element, term) of each law that several elements have, by their places."""
    found: dict[Law, list[int]] = {}
    for i, t in enumerate(terms):
        found.setdefault(law(*t), []).append(i)
    return [members for members in found.values() if len(members) > 1]


def with_siblings(products: Products, terms: Sequence[tuple[str, Term]], chosen: list[int]) -> list[int]:
    """Those of the `terms` (element, term) that stand when each law that was chosen is tried in all elements of its array.

    All of them together are pruned as the chosen ones were. Then a term whose law no other element has gives way to one whose law another
    one has, where folds that are left out are not predicted worse by more than a standard error.
    """
    laws = [law(*t) for t in terms]
    tried = [i for i, x in enumerate(laws) if x in {laws[c] for c in chosen}]
    kept = pruned(products, tried)
    if not kept or worse(products.errors(kept), products.errors(chosen)):
        kept = list(chosen)
    for k, t in enumerate(kept):
        count = Counter(laws[i] for i in kept)
        others = [i for i, (e, _) in enumerate(terms) if e == terms[t][0] and i not in kept and count[laws[i]]]
        if count[laws[t]] > 1 or not others:
            continue
        sets = [[*kept[:k], i, *kept[k + 1 :]] for i in others]
        best = min(sets, key=lambda s: float(products.errors(s).sum()))
        if not worse(products.errors(best), products.errors(kept)):
            kept = best
    return kept
