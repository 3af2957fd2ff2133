"""The error of an answer, from evaluations of one point with finer discretisations; measured errors are cached."""
