"""Blocks of a log: what is fitted to some of them is proven on others."""

import itertools

import numpy as np

BLOCK = 0.5  # s: long against the residuals' correlation, short enough for many blocks in a log


def add_products(gram: np.ndarray, columns: np.ndarray, index: np.ndarray, block: np.ndarray) -> None:
    """Add the inner products of columns (k, rows, …) to gram (blocks, c, c) at these indices, block by block.

    block (rows,) ascends: rows are in the order of time.
    """
    ends = np.searchsorted(block, np.arange(len(gram) + 1))
    for b, (first, last) in enumerate(itertools.pairwise(ends)):
        m = columns[:, first:last].reshape(len(columns), -1).astype(float)
        gram[b][np.ix_(index, index)] += m @ m.T


def sum_blocks(rows: np.ndarray, block: np.ndarray, blocks: int) -> np.ndarray:
    """Sums of rows (H, T) over each block: (H, blocks)."""
    total = np.zeros((len(rows), blocks))
    for lane, row in enumerate(rows):
        total[lane] = np.bincount(block, row, minlength=blocks)
    return total
