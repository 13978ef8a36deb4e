"""`ViewFactors`: a sparse matrix of view factors with standard errors, reciprocity, and files."""

import csv
import json
from dataclasses import dataclass, field
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...base.checks import as_array, checked_instance, items, quoted
from ...base.errors import InputError
from ...base.files import atomic_output, checked_output
from ...base.wording import counted, percent
from ...work.result_summary import Summary, SummaryTable

if TYPE_CHECKING:
    from scipy.sparse import csr_array

OUTSIDE = "sky", "ground", "other"
"""The last columns: rays that leave the scene upwards or downwards, and those that arrive at no surface's front."""

SUFFIXES = ".npz", ".csv"

_MOST_SCALINGS = 10_000
_MOST_ROWS = 20  # most surfaces in a summary
_CLOSED = 1e-13  # deviation of a row's sum from 1


@dataclass(frozen=True, eq=False)
class ViewFactors:
    """View factors between the n surfaces of a scene.

    names : list of str
        The surfaces.
    types : list of str
        Their types, such as "RoofSurface"; "": unknown.
    areas : (n,) float64
        Square metres.
    matrix : (n, n + 3) scipy.sparse.csr_array of float64
        Element (i, j) is F_ij, the share of the diffuse radiation leaving surface i that arrives at surface j. The last
        three columns are the shares that arrive at the sky, at the ground below an open scene, and elsewhere: on the
        backs of surfaces, and on faces of no surface. Each row sums to 1.
    errors : (n, n + 3) scipy.sparse.csr_array of float64
        Standard errors, with the same structure. An element that is not stored has met no ray.
    about : dict
        Settings, in JSON types.
    """

    names: list[str]
    types: list[str]
    areas: np.ndarray
    matrix: "csr_array"
    errors: "csr_array"
    about: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        areas = as_array(self.areas, "areas of view factors")
        if areas.ndim != 1 or not (np.isfinite(areas) & (areas > 0.0)).all():
            raise InputError("areas of view factors must be (n,) positive numbers")
        object.__setattr__(self, "areas", areas.astype(np.float64, copy=False))  # the class is frozen
        n = len(areas)
        for name in ("names", "types"):
            if len(items(getattr(self, name), str, f"{name} of view factors")) != n:
                raise InputError(f"{name} of view factors must be {counted(n, 'string')}, one for each area")
        for name in ("matrix", "errors"):
            matrix = getattr(self, name)
            if getattr(matrix, "format", "") != "csr" or matrix.shape != (n, n + len(OUTSIDE)):
                raise InputError(f"{name} of view factors must be a scipy.sparse.csr_array of shape {(n, n + 3)}")
        if not isinstance(self.about, dict):
            raise InputError(f"about is {quoted(self.about)}; it must be a dict")

    def __len__(self) -> int:
        return len(self.areas)

    def __repr__(self) -> str:
        return f"ViewFactors({counted(len(self), 'surface')}, {counted(self.factors.nnz, 'view factor')})"

    @property
    def factors(self) -> "csr_array":
        """(n, n) scipy.sparse.csr_array of float64: the view factors between surfaces."""
        return self.matrix[:, : len(self)]

    @property
    def sky(self) -> NDArray[np.float64]:
        """(n,) float64: the share of each surface's radiation that reaches the sky."""
        return self._outside("sky")

    @property
    def ground(self) -> NDArray[np.float64]:
        """(n,) float64: the share that leaves the scene in directions below the horizon."""
        return self._outside("ground")

    @property
    def other(self) -> NDArray[np.float64]:
        """(n,) float64: the share that arrives at the backs of surfaces, and at faces of no surface."""
        return self._outside("other")

    def _outside(self, name: str) -> NDArray[np.float64]:
        column = len(self) + OUTSIDE.index(name)
        return np.asarray(self.matrix[:, column : column + 1].toarray()[:, 0])

    @property
    def reciprocity_error(self) -> float:
        """The sum of all \\|A_i F_ij - A_j F_ji\\|, relative to that of all A_i F_ij; 0 without view factors."""
        exchange = self._exchange()
        total = float(exchange.sum())
        return float(abs(exchange - exchange.T).sum()) / total if total > 0.0 else 0.0

    def summary(self, sampled_error: float, seconds: float) -> Summary:
        """The surfaces, and the sums of their view factors.

        sampled_error : the reciprocity error before `reciprocal`
        seconds : of the study
        """
        rays, n = len(self) * self.about["samples"], self.factors.nnz
        values = {**self.about, "n": len(self), "area": float(self.areas.sum()), "rays": rays, "factors": n}
        values |= {"sampled_reciprocity_error": sampled_error, "seconds": seconds}
        error = percent(sampled_error, 2) + (" before, 0 after" if "reciprocal" in self.about else "")
        lines = [("surfaces", f"{len(self):,}"), ("view factors", f"{n:,}"), ("reciprocity error", error)]
        shares = self.factors.sum(axis=1), self.sky, self.ground, self.other
        rows = [
            (name, f"{area:,.6g}", *(f"{share:.4f}" for share in own))
            for name, area, *own in zip(
                self.names[:_MOST_ROWS], self.areas.tolist(), *(each.tolist() for each in shares)
            )
        ]
        headers = "surface", "area, m2", "surfaces", "sky", "ground", "other"
        return Summary(values, lines, table=SummaryTable(headers, rows, (1, 2, 3, 4, 5), leads=True), rays=rays)

    def _exchange(self) -> "csr_array":
        """(n, n): the exchange areas A_i F_ij."""
        return self.factors.multiply(self.areas[:, None]).tocsr()

    def reciprocal(self) -> "ViewFactors":
        """View factors with A_i F_ij = A_j F_ji, in rows that still sum to 1, as radiosity and energy balances need.

        Returns
        -------
        ViewFactors
            The two estimates of each pair are averaged with the inverses of their variances, and the rows then scaled
            symmetrically. Zeros stay zeros. `errors` are those of the averages.

        Notes
        -----
        With the same number of rays per surface, the variance of A_i F_ij is proportional to A_i, so the average is
        (F_ij + F_ji) A_i A_j / (A_i + A_j). Scaling follows [Knight et al. 2014]. It reaches sums of 1 to about 1e-13
        if the sampled pattern of zeros allows such factors.
        """
        from scipy.sparse import csr_array, hstack

        n, areas = len(self), self.areas
        both = (self.factors + self.factors.T).tocoo()
        weight = areas[both.row] * areas[both.col] / (areas[both.row] + areas[both.col])
        shared = csr_array((both.data * weight, (both.row, both.col)), shape=(n, n))
        outside = self.matrix[:, n:]
        free = areas * outside.sum(axis=1)
        scale = np.ones(n)
        for _ in range(_MOST_SCALINGS):
            sums = scale * (shared @ scale + free) / areas
            if np.abs(sums - 1.0).max(initial=0.0) < _CLOSED:
                break
            scale /= np.sqrt(sums)
        pairs = shared.tocoo()
        exchange = scale[pairs.row] * scale[pairs.col] * pairs.data
        inner = csr_array((exchange / areas[pairs.row], (pairs.row, pairs.col)), shape=(n, n))
        matrix = hstack([inner, outside.multiply(scale[:, None])], format="csr")
        errors = hstack([self._shared_errors(), self.errors[:, n:]], format="csr")
        return ViewFactors(self.names, self.types, areas, matrix, errors, {**self.about, "reciprocal": True})

    def _shared_errors(self) -> "csr_array":
        """(n, n): the standard errors of the averages of both estimates of a pair."""
        from scipy.sparse import csr_array

        n, areas = len(self), self.areas
        errors = self.errors[:, :n]
        both = (errors.multiply(errors) + errors.multiply(errors).T).tocoo()
        weight = areas[both.col] / (areas[both.row] + areas[both.col])
        return csr_array((weight * np.sqrt(both.data), (both.row, both.col)), shape=(n, n))

    def save(self, path: str | PathLike[str]) -> None:
        """Write the view factors.

        - .npz: for ``scipy.sparse.load_npz``, which reads `matrix`; also the arrays "errors" (of the stored elements),
          "areas", "names", "types", and "about" as JSON
        - .csv: a row per stored element, with the columns from, to, factor, error, area; the last one is that of the
          surface "from"

        Raises
        ------
        InputError
            If the suffix is neither, or the path cannot be written.
        """
        target = checked_output(path, SUFFIXES)
        with atomic_output(target) as temporary:
            if target.suffix.lower() == ".npz":
                with open(temporary, "wb") as file:
                    np.savez_compressed(file, allow_pickle=False, **self._arrays())
                return
            with open(temporary, "w", encoding="utf-8", newline="") as text:
                self._write_rows(csv.writer(text, lineterminator="\n"))

    def save_change(self, path: str | PathLike[str], before: "ViewFactors") -> None:
        """Write these view factors beside those before a change of the scene as .csv, a row per element of either.

        The columns are from, to, factor_loss (before minus after), factor_before, factor, error (of the loss) and area,
        for surfaces "from" of both states. Both states have the same rays, so what does not change has no loss.

        Raises
        ------
        InputError
            If the suffix is another one, the path cannot be written, or two surfaces have one name.
        """
        checked_instance(before, ViewFactors, "before")
        target = checked_output(path, SUFFIXES[1:])
        states = [each._by_names() for each in (before, self)]
        names = [name for name in self.names if name in set(before.names)]
        with atomic_output(target) as temporary, open(temporary, "w", encoding="utf-8", newline="") as text:
            rows = csv.writer(text, lineterminator="\n")
            rows.writerow(["from", "to", "factor_loss", "factor_before", "factor", "error", "area"])
            for name in names:
                earlier, later = (state.get(name, {}) for state in states)
                area = self.areas[self.names.index(name)]
                for to in dict.fromkeys([*later, *earlier]):
                    (old, old_error), (new, error) = (state.get(to, (0.0, 0.0)) for state in (earlier, later))
                    rows.writerow((name, to, old - new, old, new, float(np.sqrt(old_error**2 + error**2)), area))

    def _by_names(self) -> dict[str, dict[str, tuple[float, float]]]:
        """From -> to -> the factor and its error."""
        if len(set(self.names)) < len(self):
            raise InputError("surfaces of both states are told apart by their names, and some have the same one")
        names, errors, matrix = [*self.names, *OUTSIDE], _aligned(self.errors, self.matrix), self.matrix
        found = dict[str, dict[str, tuple[float, float]]]()
        for i, name in enumerate(self.names):
            at = slice(matrix.indptr[i], matrix.indptr[i + 1])
            values = zip(matrix.data[at].tolist(), errors[at].tolist())
            found[name] = dict(zip((names[j] for j in matrix.indices[at].tolist()), values))
        return found

    def _arrays(self) -> dict[str, Any]:
        matrix = self.matrix
        layout = {"format": np.array(b"csr"), "_is_array": np.array(True), "shape": np.array(matrix.shape)}
        layout |= {"data": matrix.data, "indices": matrix.indices, "indptr": matrix.indptr}
        names = {"names": np.array(self.names, "U"), "types": np.array(self.types, "U")}
        about = np.array(json.dumps(self.about))
        return {**layout, "errors": _aligned(self.errors, matrix), "areas": self.areas, **names, "about": about}

    def _write_rows(self, rows: Any) -> None:
        rows.writerow(["from", "to", "factor", "error", "area"])
        names, errors, matrix = [*self.names, *OUTSIDE], _aligned(self.errors, self.matrix), self.matrix
        for i in range(len(self)):
            at = slice(matrix.indptr[i], matrix.indptr[i + 1])
            columns = zip(matrix.indices[at].tolist(), matrix.data[at].tolist(), errors[at].tolist())
            rows.writerows((names[i], names[j], factor, error, self.areas[i]) for j, factor, error in columns)


def _aligned(values: "csr_array", pattern: "csr_array") -> NDArray[np.float64]:
    """(nnz,) float64: the elements of a matrix where another one has elements."""
    rows = np.repeat(np.arange(pattern.shape[0]), np.diff(pattern.indptr))
    return np.asarray(values[rows, pattern.indices]).astype(np.float64)
