"""The Monte Carlo of Eren et al. (Sensors 2017, 17(8), 1741) again."""
