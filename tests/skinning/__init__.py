"""The replay against finite differences of an analytic skinned surface, and the counts against the paper."""
