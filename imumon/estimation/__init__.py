"""Estimators behind the clock: each is a stage of the pipeline that adds columns to the samples."""
