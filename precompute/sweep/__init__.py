"""Responses to the tables of localized factor and peak acceleration."""
