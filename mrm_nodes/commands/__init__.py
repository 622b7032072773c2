"""Commands of the command line, a module each; `mrm_nodes.cli` registers them."""
