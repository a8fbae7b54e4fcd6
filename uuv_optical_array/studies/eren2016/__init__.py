"""The figures of Eren et al. (2016), computed again."""
