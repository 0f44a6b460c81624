"""The smallest productions that play: in `skeleton` they walk up, and they learn nothing."""

from __future__ import annotations

UP = """
sp {up*propose
   (state <s> ^superstate nil ^io.input-link.step <n>)
-->
   (<s> ^operator <o> +)
   (<o> ^name up ^step <n>)
}
sp {up*apply
   (state <s> ^operator <o> ^io.output-link <out>)
   (<o> ^name up ^step <n>)
-->
   (<out> ^action <a>)
   (<a> ^int-1 1 ^step <n>)
}
"""
