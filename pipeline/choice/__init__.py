"""choice"""
