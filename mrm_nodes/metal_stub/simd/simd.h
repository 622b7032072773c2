// Metal programs include it beside metal_stdlib; its types are there.
