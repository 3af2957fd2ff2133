"""The error of an answer: evaluations of one point with finer discretisations, and what is remembered of them."""
