"""The studies of the accuracy report, a file each."""
