package gluerl;

import java.util.Map;

/** An agent with numbers of its own, such as its step size: the capability {@code metrics}. */
public interface Measured {
    /**
     * Reports the numbers; this changes nothing in the agent.
     *
     * @return the value of each by name; a name has 1 to 64 characters, without line breaks
     */
    Map<String, Double> metrics();
}
