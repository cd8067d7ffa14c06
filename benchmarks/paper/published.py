"""What the paper states (Qi et al., ECCV 2024, tables 1 to 3), as it is printed there."""

# Table 1, its last row: mean absolute errors in per cent. DroidCalib needs weights and a GPU, and is only quoted.
MEAN_ERRORS = {
    "COLMAP, 20 views": 0.4,
    "DroidCalib, 20 views": 1.9,
    "C": 49.7,
    "C-BA": 61.5,
    "R": 127.0,
    "R-BA": 176.9,
    "paper": 4.3,
}
# Table 1, rows x_p and y_p of R, where the random start is held: what share of the truth it is short of it.
RANDOM_START_SHORT_BY = (0.226, -0.674)
CONFIGURATIONS = (6.7, 25.4, 41.8, 46.9, 48.2, 133.8, 19.6, 16.5, 4.4, 4.3)  # table 2
# Table 3; the last rate is printed as 100, but the text and the sequence imply 1000.
DOWNSAMPLED = {1: 4.29, 10: 4.32, 20: 4.34, 100: 4.29, 200: 4.23, 300: 4.33, 500: 4.31, 1000: 4.22}
MATCHES = 90_000  # mean number per scene, before downsampling
SPHERE_MM = 50.8
