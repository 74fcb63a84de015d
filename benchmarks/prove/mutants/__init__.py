"""Mutation: does a test fail when a module that keeps people and robots whole is changed in one place?"""
