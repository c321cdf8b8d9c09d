def model_description_3(i,o): return b""
def terminals_and_icons(i): return b""
