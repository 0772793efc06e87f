"""Watch over the bias filter: are its innovations as it expects, or does its model lack something?"""
