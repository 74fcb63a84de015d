"""Fuzzing: does every parser refuse in words what it cannot take?"""
