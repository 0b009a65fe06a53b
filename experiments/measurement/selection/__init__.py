"""Which effect is missing: linear scores, refits, held-out proof, ties, what is taken back, the verdict."""
