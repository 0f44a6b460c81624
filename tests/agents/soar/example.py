"""The smallest productions that play: they walk the skeleton upwards, and learn nothing."""

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
