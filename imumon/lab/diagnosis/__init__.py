"""Find which effect a bias model lacks, from recordings of the unit at rest."""
