/**
 * RL-Glue for Java: agents, environments and experiments as programs of their own.
 *
 * <p>Write an {@link gluerl.Agent} or an {@link gluerl.Environment} and pass it to {@link gluerl.Glue}, or ask it for an
 * {@link gluerl.Experiment}.
 */
package gluerl;
