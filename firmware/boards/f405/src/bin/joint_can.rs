//! The flashable firmware of a board between a host and the drives of an arm: master, in line, or in line of one moteus.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
foretorque_f405::image!(foretorque_f405::can_board::CanBoard);
#[cfg(target_os = "none")]
foretorque_f405::frame_handlers!(CAN1_TX CAN1_RX0 CAN2_TX CAN2_RX0 UART4 USART6);

foretorque_f405::on_the_host!();
